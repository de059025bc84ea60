"""What is wrong around a unit, seen by all axes at once: swapped outputs, wrong signs, fixture, table, place.

A rotation between table and fixture, a table that leans and a wrong latitude change what drives the unit; none of them
depends on temperature, and each does it differently: a tilted fixture tilts gravity and the table's axis, a leaning
table gravity alone, a wrong latitude the Earth's rate alone. A unit that is turned in its fixture looks like axes that
are turned in their case; it is told by both triads being turned alike, at all temperatures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from bench.analysis.imu.attitudes import earth_vector, in_table
from bench.analysis.imu.fitting import ImuFit, TriadFit, design, span
from bench.analysis.imu.scatter import components, estimate
from bench.analysis.imu.triad import Triad, TriadModel, terms
from bench.base import DPH_PER_DPS, FloatArray
from bench.record import AXES

CERTAIN = 5.0
"""Standard deviations by which something has to differ from what was stated."""
TILT_DEG, TURNED_DEG, LATITUDE_DEG = 0.1, 0.2, 2.0
"""Below these, an error is within what tables, fixtures and packages are made to, or cannot be told from noise."""


_RANK, _BLIND = 1e-6, 1e-2


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, and where."""

    cause: str
    where: str
    text: str
    look_alikes: tuple[str, ...] = ()


def outputs_of(data: Triad) -> FloatArray:
    """The signed permutation (3, 3) by which the outputs follow what should drive them; the unit matrix is right."""
    columns = np.hstack([np.ones((len(data.time), 1)), data.driving])
    matrix = np.linalg.lstsq(columns, data.output, rcond=None)[0][1:].T
    rows, chosen = linear_sum_assignment(-np.abs(matrix))
    found = np.zeros((3, 3))
    found[rows, chosen] = np.sign(matrix[rows, chosen])
    return found


def wiring(gyro: Triad, accelerometer: Triad) -> tuple[list[Finding], tuple[FloatArray, FloatArray]]:
    """Swapped outputs and wrong signs, and the permutations that undo them."""
    order = outputs_of(gyro), outputs_of(accelerometer)
    if np.array_equal(*order) and np.linalg.det(order[0]) > 0 and not np.array_equal(order[0], np.eye(3)):
        text = f"the unit stands in another attitude than stated: {_told(order[0])} in both triads"
        return [Finding("attitude", "fixture", text, ("swapped_axes",))], order
    found = []
    for data, own in zip((gyro, accelerometer), order, strict=True):
        wrong = [i for i in range(3) if own[i, i] == 0.0]
        if wrong:
            axes = " and ".join(AXES[i] for i in wrong)
            found.append(Finding("swapped_axes", f"{data.kind} {axes}", f"{data.kind}: {_told(own)}"))
        for i in (i for i in range(3) if own[i].min() < 0.0):
            text = f"{data.kind} {AXES[i]} has the wrong sign"
            found.append(Finding("wrong_sign", f"{data.kind} {AXES[i]}", text))
    return found, order


def _told(order: FloatArray) -> str:
    parts = []
    for i in range(3):
        k = int(np.argmax(np.abs(order[i])))
        if order[i, k] < 0 or k != i:
            parts.append(f"output {AXES[i]} measures {'-' if order[i, k] < 0 else ''}{AXES[k]}")
    return ", ".join(parts)


@dataclass(frozen=True, eq=False)
class World:
    """What the rows say of gravity, table and Earth, beside what was stated; (value, standard deviation)."""

    gravity_tilt_deg: tuple[FloatArray, FloatArray]
    """About east and north, in the frame of the fixture, table at 0."""
    axis_tilt_deg: tuple[FloatArray, FloatArray]
    """Of the table's axis, the same."""
    earth_dph: tuple[FloatArray, FloatArray]
    """East, north, up."""


def world(gyro: Triad, accelerometer: Triad, model: TriadModel) -> World:
    """Fit the errors of gravity, table and Earth beside all parameters of the unit; axes are joined by their weight."""
    tilt = np.degrees(1.0)
    # On a turning table a fixture's tilt turns along and a leaning table's does not: only rows that stand are asked.
    still = accelerometer.rows(np.flatnonzero(accelerometer.stay.stands))
    gravity = np.zeros(2), np.full(2, np.inf)  # a table that always turns does not show it
    if len(still.time):
        gravity = _shared(still, model, [_gravity(still, k) for k in range(2)])
    both = _shared(gyro, model, [*(_axis_tilt(gyro, k) for k in range(2)), *(_earth(gyro, k) for k in range(3))])
    return World(
        (tilt * gravity[0], tilt * gravity[1]),
        (tilt * both[0][:2], tilt * both[1][:2]),
        (both[0][2:], both[1][2:]),
    )


def _shared(data: Triad, model: TriadModel, vectors: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Parameters that are the same for all axes: values and standard deviations; `vectors` (n, 3) are their effects."""
    weight, pull = np.zeros((len(vectors),) * 2), np.zeros(len(vectors))
    for axis in range(3):
        own = tuple(terms(model, data.kind, axis, span(data, axis)))
        columns = np.hstack([design(data, axis, own, (), {}), np.stack([v[:, axis] for v in vectors], axis=1)])
        target = data.output[:, axis] - data.driving[:, axis]
        parts = {name: part for name, part in components(data, axis).items() if name != "lean"}
        scatter = estimate(columns, target, parts)
        size = np.linalg.norm(columns, axis=0)
        white = scatter.whiten(columns / np.where(size > 0.0, size, 1.0))
        own_part, given = white[:, : -len(vectors)], white[:, -len(vectors) :]
        left = given - own_part @ np.linalg.lstsq(own_part, given, rcond=None)[0]
        # What the unit's own parameters could make up for as well says nothing.
        left[:, np.linalg.norm(left, axis=0) < _RANK * np.linalg.norm(given, axis=0)] = 0.0
        left = left * size[-len(vectors) :]
        weight, pull = weight + left.T @ left, pull + left.T @ scatter.whiten(target)
    scale = np.sqrt(np.where(np.diag(weight) > 0.0, np.diag(weight), 1.0))
    values, vectors_of = np.linalg.eigh(weight / np.outer(scale, scale))
    known = values > _RANK
    half = vectors_of[:, known] / np.sqrt(values[known]) / scale[:, None]
    blind = np.linalg.norm(vectors_of[:, ~known], axis=1) > _BLIND
    return half @ (half.T @ pull), np.where(blind, np.inf, np.linalg.norm(half, axis=1))


def _gravity(data: Triad, k: int) -> FloatArray:
    """Change of the force [m/s^2] (n, 3) by a rotation of one radian about east or north."""
    size = float(np.mean(np.linalg.norm(data.force, axis=1)))
    return np.asarray(data.stay.attitude @ np.cross(np.eye(3)[k], [0.0, 0.0, size]))


def _axis_tilt(data: Triad, k: int) -> FloatArray:
    """Change of the rate [deg/h] (n, 3) by a rotation of the table's axis in the fixture."""
    turned = np.cross(np.eye(3)[k], [0.0, 0.0, 1.0])
    return np.asarray(DPH_PER_DPS * data.stay.rate_dps[:, None] * (data.stay.attitude @ turned))


def _earth(data: Triad, k: int) -> FloatArray:
    """Change of the rate (n, 3) by one deg/h of the Earth's rate to the east, north or up."""
    return np.asarray(np.einsum("nij,nj->ni", data.stay.attitude, in_table(np.eye(3)[k], data.stay)))


def place(found: World, latitude_deg: float) -> list[Finding]:
    """A tilted fixture, a leaning table, a wrong latitude or heading, out of what the rows say."""
    findings = []
    (gravity, u_gravity), (axis, u_axis) = found.gravity_tilt_deg, found.axis_tilt_deg
    if _beyond(gravity, u_gravity, TILT_DEG):
        size = float(np.linalg.norm(gravity))
        follows = _beyond(axis, u_axis, 0.5 * TILT_DEG)
        known = float(np.max(u_axis)) < 0.1 * size
        if follows or not known:
            look = () if known else ("table_tilt",)
            text = f"the fixture is tilted on the table by {size:.3f} deg ({gravity[0]:+.3f} about east, "
            findings.append(Finding("fixture_rotation", "fixture", f"{text}{gravity[1]:+.3f} about north)", look))
        else:
            findings.append(Finding("table_tilt", "table", f"the table's axis leans by {size:.3f} deg"))
    elif _beyond(axis, u_axis, TILT_DEG):
        size = float(np.linalg.norm(axis))
        findings.append(Finding("axis_tilt", "table", f"the table turns about an axis {size:.3f} deg off the vertical"))
    return findings + _on_earth(*found.earth_dph, latitude_deg)


def _on_earth(error: FloatArray, u: FloatArray, latitude_deg: float) -> list[Finding]:
    """A wrong latitude or heading, out of errors of the Earth's rate (east, north, up) and their deviations."""
    stated = earth_vector(latitude_deg)
    seen, sine = stated + error, abs(float(np.sin(np.radians(latitude_deg))))
    if not np.isfinite(u[:2]).all():
        return []
    level = float(np.hypot(seen[0], seen[1]) / np.linalg.norm(stated))
    # Its part upwards is one with g-sensitivities that are the same for all axes: the level part has the latitude.
    latitude = float(np.copysign(np.degrees(np.arccos(min(level, 1.0))), latitude_deg))
    u_latitude = float(np.degrees(u[1] / np.linalg.norm(stated) / max(sine, 0.05)))
    if abs(latitude - latitude_deg) > max(LATITUDE_DEG, CERTAIN * u_latitude):
        text = f"the Earth turns as at latitude {latitude:.1f} deg (U = {2.0 * u_latitude:.1f}), not {latitude_deg:g}"
        return [Finding("latitude", "place", text)]
    if abs(seen[0]) > CERTAIN * u[0]:
        heading = float(np.degrees(np.arctan2(seen[0], seen[1])))
        return [Finding("heading", "table", f"the Earth turns as if the table's north were {heading:.1f} deg off")]
    return []


def _beyond(value: FloatArray, u: FloatArray, least: float) -> bool:
    size = float(np.linalg.norm(value))
    return bool(size > least and size > CERTAIN * float(np.linalg.norm(u)))


def believed(data: Triad, found: World, findings: list[Finding]) -> Triad:
    """The same rows, driven as the rows say instead of as stated, where something was found."""
    causes = {finding.cause for finding in findings}
    rate, force = data.rate.copy(), data.force.copy()
    if causes & {"fixture_rotation", "table_tilt"}:
        turns_along = "fixture_rotation" in causes
        tilted = sum(a * _gravity(data, k) for k, a in enumerate(np.radians(found.gravity_tilt_deg[0])))
        force += tilted if turns_along else np.where(data.stay.stands[:, None], tilted, 0.0)
    if causes & {"fixture_rotation", "axis_tilt"} and np.isfinite(found.axis_tilt_deg[1]).all():
        rate += sum(a * _axis_tilt(data, k) for k, a in enumerate(np.radians(found.axis_tilt_deg[0])))
    if causes & {"latitude", "heading"}:
        rate += sum(e * _earth(data, k) for k, e in enumerate(found.earth_dph[0]) if np.isfinite(found.earth_dph[1][k]))
    return replace(data, rate=rate, force=force)


def turned(fit: ImuFit) -> list[Finding]:
    """A unit that is turned in its fixture, or a die in its case."""
    gyro, accelerometer = (_rotation_deg(triad) for triad in fit.triads)
    mean, apart = 0.5 * (gyro + accelerometer), gyro - accelerometer
    size = float(np.linalg.norm(mean))
    if size > TURNED_DEG and np.linalg.norm(apart) < 0.8 * size:
        about = ", ".join(f"{value:+.3f} about {axis}" for value, axis in zip(mean, AXES, strict=True))
        text = (
            f"both triads are turned by {size:.3f} deg ({about}) at all temperatures: the fixture, or the unit's foot"
        )
        return [Finding("fixture_rotation", "fixture", text, ("misalignment",))]
    findings = []
    for kind, rotation in (("gyro", gyro), ("accelerometer", accelerometer)):
        if (size := float(np.linalg.norm(rotation))) > 2.0 * TURNED_DEG:
            findings.append(Finding("die_rotation", f"{kind} die", f"the {kind}s alone are turned by {size:.3f} deg"))
    return findings


def _rotation_deg(fit: TriadFit) -> FloatArray:
    """Rotation vector (3,) [deg] of a triad against its case in the middle of its range."""
    curve = fit.axes[0].terms[0].curve
    matrix = fit.matrix(np.full((1, 3), 0.5 * (curve.low + curve.high)))[0]
    off = 0.5 * (matrix - matrix.T)
    return np.asarray(np.degrees([off[2, 1], off[0, 2], off[1, 0]]))


def straightened(data: Triad, order: FloatArray) -> Triad:
    """The outputs in the order and with the signs in which they should have been."""
    return replace(data, output=data.output @ order)
