"""Run folders made from arrays, in a fraction of a second: for every test that starts where a run has ended."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.base.channels import FloatArray
from bench.record.chain import chain_of, put
from bench.record.folder import Manifest, RunFolder
from bench.record.means import write_means

UNIT = "SIM-0001"
ARW = 0.005
"""Angle random walk of the synthetic unit [deg/sqrt(h)]."""

Leg = tuple[str, str, float, float]
"""name, kind (ramp or soak), target [degC], ramp rate [degC/min] or duration [s]"""

CYCLE: tuple[Leg, ...] = (
    ("soak at 25", "soak", 25.0, 1200.0),
    ("down to -40", "ramp", -40.0, 2.5),
    ("soak at -40", "soak", -40.0, 1200.0),
    ("up to 85", "ramp", 85.0, 2.5),
    ("soak at 85", "soak", 85.0, 1200.0),
    ("down to 25", "ramp", 25.0, 2.5),
    ("soak at 25 again", "soak", 25.0, 1200.0),
)


def ramp_run(
    legs: Sequence[Leg] = CYCLE, *, rate_hz: float = 2.0, seed: int = 1, loop_dph: float = 0.4
) -> dict[str, Any]:
    """Columns and segments of a unit with a curve in temperature, a loop of rate-independent hysteresis and noise.

    Returns `{"columns": ..., "segments": ...}` for `make_run`. Truth: `truth_dph` of the temperature plus
    `loop_dph` times a play operator of half-width 5 degC, white noise `ARW`.
    """
    knots, segments = _schedule(legs)
    time = np.arange(0.5 / rate_hz, knots[-1][0], 1 / rate_hz)
    setpoint = np.interp(time, [t for t, _ in knots], [degc for _, degc in knots])
    temperature = _lagged(setpoint, 1 / rate_hz, 120.0)
    random = np.random.default_rng(seed)
    white = ARW * np.sqrt(3600 * rate_hz)
    columns = {
        "time": time,
        "rate": truth_dph(temperature)
        + loop_dph * _play(temperature, 5.0) / 5.0
        + random.normal(0.0, white, time.size),
        "temperature": temperature,
        "frequency": 14000.0 * (1 - 25e-6 * (temperature - 25.0) + 20e-9 * (temperature - 25.0) ** 2),
        "drive": 1.0 + 2e-4 * (temperature - 25.0) + 1e-6 * (temperature - 25.0) ** 2,
        "quadrature": 0.02 + 3e-5 * (temperature - 25.0) - 4e-7 * (temperature - 25.0) ** 2,
        "chamber_temperature": _lagged(setpoint, 1 / rate_hz, 30.0),
        "chamber_setpoint": setpoint,
    }
    for name, scatter in (("temperature", 0.01), ("frequency", 0.005), ("drive", 2e-5), ("quadrature", 2e-5)):
        columns[name] = columns[name] + random.normal(0.0, scatter, time.size)
    starts = [segment["from_s"] for segment in segments]
    columns["segment"] = np.searchsorted(starts, time, side="right") - 1
    return {"columns": columns, "segments": segments}


def truth_dph(temperature: FloatArray) -> FloatArray:
    """Static bias of the synthetic unit [deg/h]."""
    x = temperature / 60.0
    bias: FloatArray = 12.0 + 3.0 * x - 2.0 * x**2 + 1.5 * x**3 + 0.4 * np.sin(4 * x)
    return bias


def make_run(
    folder: Path, columns: Mapping[str, Any], segments: Sequence[Mapping[str, Any]] = (), **manifest: Any
) -> Path:
    """Write data.parquet, means.parquet and manifest.json of a finished run; keywords go into the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    run = RunFolder(folder)
    table = pa.table({name: pa.array(_typed(name, values), from_pandas=True) for name, values in columns.items()})
    pq.write_table(table, run.data)
    write_means(run.data, run.means)
    (folder / "events.jsonl").write_text(
        json.dumps({"t_s": 0.0, "kind": "run", "text": "start"}) + "\n", encoding="utf-8"
    )
    content = {
        "run": folder.name, "unit": UNIT, "created": "2026-11-21T06:00:00+00:00", "profile": "ramp_-40_85",
        "state": "done", "cause": "end of profile", "segments": list(segments), "sample_rate_hz": 2,
        "losses": {"received": table.num_rows, "lost": 0, "repeated": 0, "corrupt": 0, "late": 0},
        "versions": {"bench": "0.1.0"}, "seeds": {}, "files": run.hashes(), **manifest,
    }  # fmt: skip
    Manifest.model_validate(content).write(folder)
    return folder


def _typed(name: str, values: Any) -> Any:
    return np.asarray(values, dtype=np.int16 if name == "segment" else np.float64)


def _schedule(legs: Sequence[Leg]) -> tuple[list[tuple[float, float]], list[dict[str, Any]]]:
    knots, segments, at = [(0.0, legs[0][2])], [], 0.0
    for index, (name, kind, target, amount) in enumerate(legs):
        before = knots[-1][1]
        length = 60.0 * abs(target - before) / amount if kind == "ramp" else amount
        direction = "constant" if kind == "soak" else "heating" if target > before else "cooling"
        segments.append({
            "index": index, "name": name, "kind": kind, "from_s": at, "to_s": at + length, "target_degc": target,
            "rate_degc_per_min": amount if kind == "ramp" else None, "direction": direction, "settled": True,
            "outcome": "done",
        })  # fmt: skip
        at += length
        knots.append((at, target))
    return knots, segments


def _lagged(values: FloatArray, dt_s: float, tau_s: float) -> FloatArray:
    from scipy.signal import lfilter

    a = np.exp(-dt_s / tau_s)
    out: FloatArray = lfilter([1 - a], [1, -a], values, zi=[a * values[0]])[0]
    return out


def _play(values: FloatArray, half_width: float) -> FloatArray:
    """Play operator: the centre of a slack of +-half_width that is dragged along."""
    out = np.empty_like(values)
    centre = values[0]
    for i, value in enumerate(values.tolist()):
        centre = min(max(centre, value - half_width), value + half_width)
        out[i] = centre
    return values - out


def keep(folder: Path, name: str, content: Any) -> None:
    """Put a file into a folder as the bench does: the folder's chain lists it.

    Results are then those of a new manifest, as if they had been made from it.
    """
    files = {name: (content if isinstance(content, str) else json.dumps(content)).encode()}
    known = chain_of(folder)
    if name != "manifest.json" or known is None:
        put(folder, files, ["manifest.json"])
        return
    results = [other for other, link in known.files.items() if link.made_from]
    put(folder, files, unit=content.get("unit", ""), run=content.get("run", ""))
    put(folder, {other: (folder / other).read_bytes() for other in results}, ["manifest.json"])
