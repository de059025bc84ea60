"""What can be known about a profile before anything moves: findings by line, expected times, and a picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from bench.acquisition.profile.legs import Leg
from bench.acquisition.profile.orientation import OrientationSettings, latitude, stated
from bench.acquisition.profile.placing import Reach, attitude_findings
from bench.acquisition.profile.profile import Profile, taken_name
from bench.base import FloatArray, InputError
from bench.record import NOT_STATED, earth_told

Level = Literal["error", "warning", "info"]
RateCurve = Sequence[tuple[float, float]]
"""What a chamber can do: pairs of temperature [degC] and rate [degC/min], straight lines between them."""

_NEAR_DEGC = 2.0
_FROST_MARGIN_DEGC = 8.0
_SHORTEST_SOAK_S = 900.0
LEAST_STRETCH_S = 300.0
"""As the analysis reads the noise floor from (`bench/analysis/thresholds.py`, which this half does not import)."""


@dataclass(frozen=True)
class Finding:
    """One thing to know before the run; an error means that the profile cannot run here."""

    level: Level
    text: str
    file: str | None = None
    line: int | None = None

    def __str__(self) -> str:
        return f"{self.where}{self.level}: {self.text}"

    @property
    def where(self) -> str:
        """File and line before a text; empty where it has none."""
        return "" if self.line is None else f"{self.file or 'profile'}:{self.line}: "


@dataclass(frozen=True)
class Limits:
    """What the station allows and its chamber can do; a curve may be one number."""

    low_degc: float
    high_degc: float
    heating: RateCurve | float
    cooling: RateCurve | float
    ambient_degc: float = 23.0
    turn_dps: float | None = None
    """Fastest rate of the rate table, either way [deg/s]; None: the station has no table."""
    switches_power: bool = False
    """Whether the station has a supply that switches the units' power."""
    orientation: OrientationSettings | None = None
    """What the station states of latitude, axis and azimuth."""
    fixture: Reach | None = None
    """The attitudes that its fixture reaches; None: it has no fixture."""

    def fastest(self, temperature_degc: FloatArray, heating: bool) -> FloatArray:
        """Fastest rate that the chamber can follow [degC/min], shape of the input."""
        curve = self.heating if heating else self.cooling
        if isinstance(curve, int | float):
            return np.full(np.shape(temperature_degc), float(curve))
        degc, rate = np.array(sorted(curve), dtype=np.float64).T
        return np.asarray(np.interp(temperature_degc, degc, rate), dtype=np.float64)


@dataclass(frozen=True)
class Recording:
    """What a run records and where to; from it the disk that it needs."""

    rates_hz: Sequence[float] = (500.0,)
    """Samples in a second, by unit."""
    bytes_per_s: float = 20_000.0
    """Of all units."""
    free_bytes: float | None = None


def check_profile(
    profile: Profile,
    limits: Limits,
    recording: Recording | None = None,
    plant_duration_s: Callable[[Profile], float] | None = None,
    guarded: str = "",
    fitted: bool = True,
) -> tuple[Finding, ...]:
    """All findings, the worst first. `plant_duration_s` predicts the duration [s] better than the rate curves do.

    `guarded` says which guards every run has; `fitted`: effects are to be told apart by it.
    """
    duration_s = plant_duration_s(profile) if plant_duration_s is not None else expected_duration_s(profile, limits)
    rules: tuple[Iterator[Finding], ...] = (
        _named(profile),
        _outside(profile, limits),
        _too_fast(profile, limits),
        _turns(profile, limits),
        _power(profile, limits),
        _earth(profile, limits),
        _attitudes(profile, limits),
        _ends(profile, limits),
        _repeats(profile),
        _separates(profile) if fitted else iter(()),
        _soaks(profile),
        _record(profile, duration_s, recording or Recording()),
        (_find(profile, "info", text) for text in filter(None, [guarded])),
    )
    order = ("error", "warning", "info")
    found = [finding for rule in rules for finding in rule]
    return tuple(sorted(found, key=lambda finding: order.index(finding.level)))


def refuse_errors(findings: Sequence[Finding]) -> None:
    """Raise InputError with every error among the findings, the first one's place; nothing when there is none."""
    errors = [finding for finding in findings if finding.level == "error"]
    if errors:
        further = "".join(f"\n{finding.where}{finding.text}" for finding in errors[1:])
        raise InputError(errors[0].text + further, errors[0].file, errors[0].line)


def expected_duration_s(profile: Profile, limits: Limits) -> float:
    """Duration [s] with the chamber as slow as its rate curves say; settling beyond the dwell time is not in it."""
    return sum(leg.nominal_s - leg.move_s + _move_s(leg, limits) for leg in profile.legs())


def _move_s(leg: Leg, limits: Limits) -> float:
    """Time that the chamber air needs to the target [s]."""
    if leg.target_degc == leg.from_degc:
        return 0.0
    edges = np.linspace(leg.from_degc, leg.target_degc, 201)
    fastest = limits.fastest((edges[1:] + edges[:-1]) / 2, leg.target_degc > leg.from_degc)
    wanted = np.inf if leg.rate_degc_per_min is None else leg.rate_degc_per_min
    return float(60.0 * np.sum(np.abs(np.diff(edges)) / np.minimum(fastest, wanted)))


def _find(profile: Profile, level: Level, text: str, leg: Leg | None = None) -> Finding:
    return Finding(level, text, profile.file, None if leg is None else leg.line)


def _once_a_line(legs: Sequence[Leg]) -> Iterator[Leg]:
    """Legs that a repeat made several times, once."""
    seen: set[tuple[int | None, float, float]] = set()
    for leg in legs:
        key = (leg.line, leg.from_degc, leg.target_degc)
        if leg.line is None or key not in seen:
            seen.add(key)
            yield leg


def _named(profile: Profile) -> Iterator[Finding]:
    if text := taken_name(profile):
        yield Finding("warning", text, profile.file, profile.line)


def _outside(profile: Profile, limits: Limits) -> Iterator[Finding]:
    for leg in _once_a_line(profile.legs()):
        if (
            leg.kind not in {"soak", "rate", "power_cycle"}
            and not limits.low_degc <= leg.target_degc <= limits.high_degc
        ):
            text = f"{leg.name}: {leg.target_degc:g} degC is outside the station's limits, "
            text += f"{limits.low_degc:g} to {limits.high_degc:g} degC; lower the target or name another station"
            yield _find(profile, "error", text, leg)


def _too_fast(profile: Profile, limits: Limits) -> Iterator[Finding]:
    for leg in _once_a_line(profile.legs()):
        if leg.rate_degc_per_min is None or leg.direction == "constant":
            continue
        degc = np.linspace(leg.from_degc, leg.target_degc, 201)
        fastest = limits.fastest(degc, leg.direction == "heating")
        short = fastest < leg.rate_degc_per_min * (1 - 1e-9)
        late_s = _move_s(leg, limits) - leg.move_s
        if np.any(short) and late_s > 30.0:
            first, last = degc[short][0], degc[short][-1]
            text = f"{leg.name}: from {first:.0f} to {last:.0f} degC the chamber can only do "
            text += f"{np.min(fastest):.2g} degC/min; the leg waits for it, about {late_s / 60:.0f} min longer"
            yield _find(profile, "warning", text, leg)


def _turns(profile: Profile, limits: Limits) -> Iterator[Finding]:
    turning = [leg for leg in profile.legs() if leg.turn_dps]
    if not turning:
        return
    if limits.turn_dps is None:
        text = f"{turning[0].name}: turns a rate table, but the station has none; name a station with `rate_table`"
        yield _find(profile, "error", text, turning[0])
        return
    for line in dict.fromkeys(leg.line for leg in turning):
        fastest = max((leg for leg in turning if leg.line == line), key=lambda leg: abs(leg.turn_dps))
        if abs(fastest.turn_dps) > limits.turn_dps:
            text = f"{fastest.name}: {fastest.turn_dps:g} deg/s is outside the rate table's limits, "
            yield _find(profile, "error", f"{text}+-{limits.turn_dps:g} deg/s; lower the rate", fastest)
    for sign, missing in ((1, "negative"), (-1, "positive")):
        if all(sign * leg.turn_dps >= 0 for leg in turning):
            text = f"turns one way only, no {missing} rates: scale factor and bias cannot be told from each other there"
            yield _find(profile, "warning", text, turning[-1])


def _power(profile: Profile, limits: Limits) -> Iterator[Finding]:
    cycles = [leg for leg in profile.legs() if leg.kind == "power_cycle"]
    if not cycles:
        return
    if not limits.switches_power:
        text = f"{cycles[0].name}: switches the units' power, but the station has no supply that the bench can switch"
        yield _find(profile, "error", f"{text}; name a station with an instrument that has `powers_units`, "
                    "or leave the segment out", cycles[0])  # fmt: skip
        return
    off_s = sum(leg.duration_s for leg in cycles)
    text = f"{len(cycles)} power cycle(s), {_hours(off_s)} without power: {len(cycles) + 1} turn-ons in one run; "
    yield _find(profile, "info", f"{text}while the power is off, guards on what the units say do not watch", cycles[0])


def _attitudes(profile: Profile, limits: Limits) -> Iterator[Finding]:
    known = latitude(limits.orientation, profile.orientation) is not None
    for level, text, leg in attitude_findings(profile.legs(), limits.fixture, limits.ambient_degc, known):
        yield _find(profile, level, text, leg)


def _earth(profile: Profile, limits: Limits) -> Iterator[Finding]:
    if any(leg.attitude is not None for leg in profile.legs()):
        return  # the axes lie as the attitudes say
    orientation, missing = stated(limits.orientation, profile.orientation)
    if orientation is None:
        given = limits.orientation is not None or profile.orientation is not None
        text = f"{NOT_STATED}; `orientation` of station or profile does not state {', '.join(missing)}"
        yield _find(profile, "warning" if given else "info", text)
        return
    yield _find(profile, "info", earth_told(orientation))
    turning = [leg for leg in profile.legs() if leg.turn_dps]
    if turning and orientation.axis == "level":
        text = f"{turning[0].name}: the axis is level and the table's is taken to be vertical: the axis goes round with"
        yield _find(profile, "warning", f"{text} it, and only a part of the table's rate is along it", turning[0])


def _ends(profile: Profile, limits: Limits) -> Iterator[Finding]:
    last = profile.legs()[-1]
    if last.target_degc < limits.ambient_degc - _FROST_MARGIN_DEGC:
        text = f"ends at {last.target_degc:g} degC: opened there, unit and chamber collect water and frost; "
        yield _find(profile, "warning", f"{text}end near {limits.ambient_degc:g} degC", last)


def _repeats(profile: Profile) -> Iterator[Finding]:
    legs = profile.legs()
    start_degc = legs[0].target_degc if profile.start is not None else legs[0].from_degc
    here = [leg for leg in legs[1:] if abs(leg.target_degc - start_degc) <= _NEAR_DEGC]
    away = [leg.index for leg in legs if abs(leg.target_degc - start_degc) > _NEAR_DEGC]
    if not away:
        return
    back = [leg for leg in here if leg.index > away[0]]
    if not back:
        text = f"never returns to its start temperature, {start_degc:g} degC: drift, warm-up and creep cannot be told"
        yield _find(profile, "warning", f"{text} from temperature", legs[-1])
    elif all(leg.index > away[-1] for leg in back):
        text = f"returns to its start temperature, {start_degc:g} degC, only at the end; a stop in the middle"
        yield _find(profile, "info", f"{text} would separate warm-up from ageing")


def _moving(profile: Profile) -> list[Leg]:
    """Legs in which the temperature goes one way, without the way to the start."""
    return [leg for leg in profile.legs()[profile.start is not None :] if leg.direction != "constant"]


def turning_points(profile: Profile) -> list[tuple[float, Leg]]:
    """Temperatures [degC] where the profile changes direction, each with the leg that leads there."""
    moving = _moving(profile)
    pairs = pairwise(moving)
    return [(leg.target_degc, leg) for leg, after in pairs if leg.direction != after.direction]


def _separates(profile: Profile) -> Iterator[Finding]:
    ramps = [leg for leg in _moving(profile) if leg.kind == "ramp"]
    if not ramps:
        text = "has no ramps: a thermal lag and a dT/dt term do not show, and hysteresis shows weakly"
        yield _find(profile, "info", text)
        return
    for missing in {"heating", "cooling"} - {leg.direction for leg in _moving(profile)}:
        yield _find(profile, "warning", f"has no {missing} branch: hysteresis cannot be seen")
    rates = {round(leg.rate_degc_per_min or 0.0, 2) for leg in ramps}
    if len(rates) == 1:
        text = f"all ramps at {rates.pop():g} degC/min: thermal lag, dT/dt and hysteresis cannot be separated;"
        yield _find(profile, "warning", f"{text} give some ramps another rate", ramps[-1])
    degc = [leg.target_degc for leg in profile.legs()]
    margin = 0.05 * (max(degc) - min(degc))
    if not any(min(degc) + margin < turn < max(degc) - margin for turn, _ in turning_points(profile)):
        text = "has no reversal inside its range (no minor loop): dT/dt and hysteresis are hard to separate; "
        yield _find(profile, "warning", f"{text}turn back once half-way, it costs no time")


def _soaks(profile: Profile) -> Iterator[Finding]:
    soaks = [leg for leg in profile.legs() if leg.kind == "soak"]
    longest_s = max((leg.duration_s for leg in soaks), default=0.0)
    if longest_s < _SHORTEST_SOAK_S:
        text = f"longest soak is {longest_s / 60:.0f} min: the noise floor is read where the unit stands still for"
        text += f" {LEAST_STRETCH_S / 60:.0f} min, which takes a soak of about {_SHORTEST_SOAK_S / 60:.0f} min"
        yield _find(profile, "warning", text, soaks[-1] if soaks else None)


def _record(profile: Profile, duration_s: float, recording: Recording) -> Iterator[Finding]:
    degc = [leg.target_degc for leg in profile.legs()]
    text = f"{min(degc):g} to {max(degc):g} degC in {len(profile.legs())} legs, nominal {_hours(profile.duration_s)}, "
    yield _find(profile, "info", f"{text}expected at least {_hours(duration_s)} on this chamber")
    need = duration_s * recording.bytes_per_s
    rates = "; ".join(
        f"{duration_s * rate_hz:,.0f} samples ({rate_hz:g} Hz) of each of {count} unit(s)"
        for rate_hz, count in Counter(recording.rates_hz).items()
    )
    text = f"{rates}, about {need / 1e6:,.0f} MB on disk"
    if recording.free_bytes is not None and need > recording.free_bytes:
        free = f"only {recording.free_bytes / 1e6:,.0f} MB are free; free some or choose another place with --out"
        yield _find(profile, "error", f"{text}; {free}")
    else:
        yield _find(profile, "info", text)


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def profile_picture(profile: Profile, width: int = 78, height: int = 12) -> str:
    """Set point over nominal time as text of `width` columns, `height` rows and a time axis."""
    columns = max(width - 7, 16)
    fine, tall = 2, 4  # dots of a Braille letter
    times = np.linspace(0.0, profile.duration_s, columns * fine)
    degc = profile.setpoint(times)
    corners = profile.corners()[1]
    low, high = float(corners.min()), float(corners.max())
    if low == high:
        low, high = low - 1.0, high + 1.0
    span = high - low
    rows = np.rint((high - degc) / span * (height * tall - 1)).astype(int)
    dots = np.zeros((height * tall, columns * fine), dtype=bool)
    for x, row in enumerate(rows):
        before = rows[x - 1] if x else row
        dots[min(before + np.sign(row - before), row) : max(before + np.sign(row - before), row) + 1, x] = True
    lines = []
    for y in range(height):
        label = high - span * (y + 0.5) / height if 0 < y < height - 1 else (high if y == 0 else low)
        marked = f"{label:6.0f}" if y in {0, height // 2, height - 1} else " " * 6
        block = dots[y * tall : (y + 1) * tall]
        cells = (block[:, x * fine : (x + 1) * fine] for x in range(columns))
        lines.append(f"{marked} " + "".join(_cell(cell) for cell in cells).rstrip())
    hours = profile.duration_s / 3600
    if cycles := [leg.nominal_start_s for leg in profile.legs() if leg.kind == "power_cycle"]:
        marks = {min(int(start / profile.duration_s * columns), columns - 1) for start in cycles}
        lines.append(f"{'power':>6} " + "".join("x" if x in marks else " " for x in range(columns)).rstrip())
    axis = f"{'degC':>6} 0 h" + f"{hours / 2:.1f} h".center(columns - 10) + f"{hours:.1f} h"
    return "\n".join([*lines, axis])


def _cell(dots: np.ndarray[tuple[int, int], np.dtype[np.bool_]]) -> str:
    if not dots.any():
        return " "
    weights = np.array([[1, 8], [2, 16], [4, 32], [64, 128]])
    return chr(0x2800 + int(np.sum(weights[dots])))
