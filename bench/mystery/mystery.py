"""A unit with hidden effects: recorded, sealed, and revealed after the user has named them.

`make_mystery` draws mechanisms from the truth's catalogue, which is larger than the library of effects, and records
three runs of the unit in the simulated physics: a calibration run, a check run and an isothermal one. The envelope
contains the truth, encoded but not encrypted. `reveal` scores a model against it.
"""

from __future__ import annotations

import base64
import binascii
import json
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.acquisition import profile_from_text
from bench.analysis import Model, fit_model, make
from bench.base import FloatArray, InputError, __version__, read_text
from bench.mystery import virtual
from bench.mystery.hidden import CHANNELS, HIDDEN, NOISE, Entry, draw, scaled, static_curve
from bench.record import Dataset, Manifest, RunFolder, create_run, load, write_means
from drivers.sim.resonator import UnitSettings

ENVELOPE = "envelope.txt"
_HEAD = "Sealed truth of a mystery unit. Name its effects first, then open it with `bench reveal`."
_STATIC = (
    "name: isothermal\nstart: {temperature_degc: 25, soak_min: 60}\nsegments:\n  - {kind: soak, duration_min: 180}\n"
)
_STRENGTHS = (1.0, 4.0)
_RUNS = ("run", "check", "static")
_SILENT = dict.fromkeys(NOISE, 0.0)
_CURVE_ORDER = 12
_CURVES = "static"  # family of effects that are curves over temperature; they do not count as named


@dataclass(frozen=True)
class Mystery:
    """Folders of the three runs, and the envelope."""

    folder: Path
    run: Path
    check: Path
    static: Path
    envelope: Path


@dataclass(frozen=True)
class Score:
    """Score of a model against the truth. Errors [deg/h] are RMS on the check run; `floor_dph` is that of the truth."""

    hidden: tuple[dict[str, Any], ...]
    """mechanism, effect (None: outside the library) and strength of each."""
    right: tuple[str, ...]
    wrong: tuple[str, ...]
    missed: tuple[str, ...]
    outside: tuple[str, ...]
    """Mechanisms without an effect in the library; the correct diagnosis is `unknown`."""
    held_out_rms_dph: float
    true_model_rms_dph: float
    floor_dph: float

    def to_json(self) -> dict[str, Any]:
        """The object of `bench reveal --json`."""
        return asdict(self)


def make_mystery(seed: int, effects_count: int, out: Path, calibration: Path, check: Path) -> Mystery:
    """Record a unit with `effects_count` hidden mechanisms on two profiles into `out`; deterministic by seed.

    Raises InputError: too many effects for the catalogue, a folder that already contains a mystery, a bad profile.
    """
    drawable = [h for h in HIDDEN.values() if not h.turns]
    if not 1 <= effects_count <= len(drawable) // 4:
        raise InputError(f"--effects is {effects_count}, allowed are 1 to {len(drawable) // 4}")
    envelope = out / ENVELOPE
    if envelope.exists():
        raise InputError("already contains a mystery; reveal it, or choose another folder with --out", out)
    texts = dict(zip(_RUNS, (read_text(calibration), read_text(check), _STATIC), strict=True))
    files = dict(zip(_RUNS, (str(calibration), str(check), "isothermal"), strict=True))
    traces = {n: virtual.chamber(profile_from_text(texts[n], files[n]), seed=seed + i) for i, n in enumerate(_RUNS)}
    truth, strengths = _unit(seed, effects_count, traces["run"])
    created = datetime.now(UTC)
    folders = {}
    for number, name in enumerate(_RUNS):
        samples = virtual.unit(_settings(truth, name, NOISE), traces[name], _seed(seed, number))
        own = profile_from_text(texts[name], files[name]).name
        folders[name] = create_run(out, f"MYSTERY-{seed}", own, created, {"profile.yaml": texts[name]})
        _write(folders[name], samples, traces[name], created, f"MYSTERY-{seed}", own)
    paths = {name: str(folder.path.relative_to(out)) for name, folder in folders.items()}
    _seal(envelope, {"format": 1, "seed": seed, "truth": truth, "strengths": strengths, "runs": paths})
    return Mystery(out, folders["run"].path, folders["check"].path, folders["static"].path, envelope)


def _unit(seed: int, count: int, trace: virtual.Trace) -> tuple[list[Entry], dict[str, float]]:
    """The static curve and the hidden mechanisms, with the strength of each on the calibration run."""
    rng = np.random.default_rng([seed, 20])
    curve = static_curve(rng)
    chosen: list[str] = []
    names = [h.mechanism for h in HIDDEN.values() if not h.turns]
    for name in rng.permutation(names):
        taken = {HIDDEN[other].group for other in chosen} - {""}
        if len(chosen) < count and HIDDEN[name].group not in taken:
            chosen.append(str(name))
    clean = _temperature_and_rate([curve], _SILENT, trace, _seed(seed, 0))
    noisy = _temperature_and_rate([curve], NOISE, trace, _seed(seed, 0))
    noise = _beyond_curve(noisy[0], noisy[1] - clean[1])

    def share(entry: Entry) -> float:
        temperature, rate = _temperature_and_rate([curve, entry], _SILENT, trace, _seed(seed, 0))
        return _beyond_curve(temperature, rate - clean[1])

    strengths = {name: float(np.exp(rng.uniform(*np.log(_STRENGTHS)))) for name in chosen}
    hours = trace.seconds / 3600.0
    hidden = [scaled(draw(name, rng, hours), strengths[name] * noise, share) for name in chosen]
    return [curve, *hidden], strengths


def _seed(seed: int, number: int) -> int:
    return 10 * seed + number


def _settings(truth: list[Entry], run: str, noise: Mapping[str, float]) -> UnitSettings:
    """The unit during a run; mechanisms of one run act in the calibration run only."""
    own = [e for e in truth if run == "run" or e["mechanism"] not in HIDDEN or not HIDDEN[e["mechanism"]].one_run]
    return UnitSettings.parse({"truth": own, "noise": dict(noise), "channels": CHANNELS})


def _temperature_and_rate(
    truth: list[Entry], noise: Mapping[str, float], trace: virtual.Trace, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Means over 30 s of temperature [degC] and rate [deg/h]."""
    channels = virtual.unit(_settings(truth, "run", noise), trace, seed).channels
    temperature = channels["temperature"][np.isfinite(channels["temperature"])]
    rows = trace.seconds // 30
    rate = channels["rate"].reshape(trace.seconds, -1).mean(axis=1)
    return (temperature[: 30 * rows].reshape(rows, 30).mean(axis=1), rate[: 30 * rows].reshape(rows, 30).mean(axis=1))


def _beyond_curve(temperature: FloatArray, rate: FloatArray) -> float:
    """RMS of the rate beyond a smooth curve over temperature [deg/h]."""
    ends = [float(temperature.min()), float(temperature.max())]
    basis = np.polynomial.chebyshev.chebvander(np.interp(temperature, ends, [-1.0, 1.0]), _CURVE_ORDER)
    left = rate - basis @ np.linalg.lstsq(basis, rate, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _write(
    run: RunFolder, samples: virtual.Samples, trace: virtual.Trace, created: datetime, unit: str, profile: str
) -> None:
    columns = {"time": samples.time, **samples.channels}
    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})
    table = table.append_column("segment", pa.array(samples.segment.astype(np.int16)))
    pq.write_table(table, run.data, compression="zstd", write_page_checksum=True)
    write_means(run.data, run.means)
    (run.path / "events.jsonl").write_text("")
    Manifest(
        run=run.path.name,
        unit=unit,
        profile=profile,
        created=created.isoformat(timespec="seconds"),
        state="done",
        cause="finished",
        simulated=True,
        sample_rate_hz=virtual.RATE_HZ,
        rows=len(samples.time),
        duration_s=float(trace.seconds),
        segments=trace.segments,
        losses={},
        versions={"bench": __version__, "numpy": np.__version__},
        seeds={},
        files=run.hashes(),
    ).write(run.path)


def _seal(path: Path, content: Mapping[str, Any]) -> None:
    packed = base64.b85encode(zlib.compress(json.dumps(content).encode(), 9)).decode()
    lines = [packed[i : i + 100] for i in range(0, len(packed), 100)]
    path.write_text("\n".join([_HEAD, *lines]) + "\n", encoding="utf-8")


def _open(folder: Path) -> dict[str, Any]:
    path = folder / ENVELOPE
    if not path.is_file():
        raise InputError("no envelope: name the folder that `bench mystery` made", folder)
    lines = path.read_text(encoding="utf-8").splitlines()
    try:
        content = json.loads(zlib.decompress(base64.b85decode("".join(lines[1:]))))
    except (ValueError, zlib.error, binascii.Error) as error:
        raise InputError(f"the envelope is damaged ({error})", path) from None
    return dict(content)


def reveal(folder: Path, model: Model) -> Score:
    """Open the envelope of a mystery and score a model; InputError without an envelope or without a fit."""
    content = _open(folder)
    truth, seed = content["truth"], int(content["seed"])
    mechanisms = [entry["mechanism"] for entry in truth[1:]]
    covered = {HIDDEN[name].effect for name in mechanisms} - {None}
    named = [effect for effect in model.effects if effect.family != _CURVES]
    names = list(dict.fromkeys(effect.name for effect in named))
    run, check = (load(folder / content["runs"][name]) for name in ("run", "check"))
    best = Model("true", tuple(e for e in model.effects if e.family == _CURVES) or (make("spline"),))
    for name in sorted(map(str, covered)):
        best = best.adding(make(name).suited([run]))
    perfect = _without_noise(folder / content["runs"]["check"], truth, seed)

    def error(candidate: Model) -> float:
        return _rms(check.bias - fit_model(candidate, run, covariance="none").predict(check).bias)

    return Score(
        hidden=tuple(
            {"mechanism": m, "effect": HIDDEN[m].effect, "strength": round(content["strengths"][m], 2)}
            for m in mechanisms
        ),
        right=tuple(name for name in names if name in covered),
        wrong=tuple(name for name in names if name not in covered),
        missed=tuple(sorted(str(name) for name in covered if name not in names)),
        outside=tuple(m for m in mechanisms if HIDDEN[m].effect is None),
        held_out_rms_dph=error(model),
        true_model_rms_dph=error(best),
        floor_dph=_rms(check.bias - perfect.bias),
    )


def _without_noise(run: Path, truth: list[Entry], seed: int) -> Dataset:
    """The check run without noise: the prediction of a perfect model."""
    trace = virtual.chamber(profile_from_text(read_text(run / "profile.yaml")), seed=seed + 1)
    samples = virtual.unit(_settings(truth, "check", _SILENT), trace, _seed(seed, 1))
    with tempfile.TemporaryDirectory() as folder:
        _write(RunFolder(Path(folder)), samples, trace, datetime.now(UTC), "", "")
        return load(folder)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
