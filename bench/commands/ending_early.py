"""`until` of a profile: a run ends when the lot's units and its own rows promise a calibration that is good enough."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import acquisition, analysis
from bench.base import InputError, dump, parse_yaml, read_yaml
from bench.record import (
    EARTH,
    CalibrationRecord,
    Dataset,
    LotRecord,
    Manifest,
    Orientation,
    UntilRecord,
    earth_rate,
    load,
    slug,
    use,
)

WHO = "the lot's prior"
KEPT = "lot.yaml"
"""File of a run folder: the lot that may end the run, and whether the run is an audit."""
LOOK_S = 600.0
ROW_S = 30.0


def followed(profile: acquisition.Profile, lot: Path | None, out: Path) -> dict[str, str]:
    """The file that a run keeps of its lot, by name; none where the run goes to its end in any case.

    `lot`: run folder of the lot; None: the one that the profile names, below `out`. InputError where it is none, or the
    profile does not say when a run may end.
    """
    until = profile.until
    if until is None and lot is not None:
        raise InputError("--lot needs `until: {error_dph: …}` in the profile", profile.file)
    if until is None or (lot is None and until.lot is None):
        return {}
    folder = _newest(until.lot or "", out, profile.file) if lot is None else lot
    LotRecord.read(folder)
    return {KEPT: dump({"lot": str(folder.resolve()), "audit": audit_due(out, folder, until.audit_every)})}


def _newest(lot: str, out: Path, file: str | None) -> Path:
    """Run folder of a lot by its name, or by name and run."""
    name, _, run = lot.partition("/")
    found = sorted(path.parent for path in (out / slug(name)).glob(f"{slug(run) if run else '*'}/{LotRecord.FILE}"))
    if not found:
        text = f"until.lot: no lot '{lot}' was calibrated in {out}"
        raise InputError(f"{text}; make it with `bench lot calibrate`, or leave `lot` out", file)
    return found[-1]


def lot_of(run: Path) -> tuple[Path, bool] | None:
    """Run folder of the lot that a run followed, and whether the run is an audit; None for one that followed none."""
    if not (run / KEPT).is_file():
        return None
    use(run, KEPT)
    return _kept(read_yaml(run / KEPT).content)


def _kept(content: Any) -> tuple[Path, bool]:
    return Path(content["lot"]), bool(content["audit"])


def prior_of(folder: Path) -> analysis.Prior:
    """The units of a lot, from its run folder, as the prior of a further one."""
    record, stored = LotRecord.read(folder), CalibrationRecord.read(folder)
    if stored.calibration is None:
        raise InputError("holds no calibration of a lot; make it with `bench lot calibrate`", folder)
    model = analysis.model_from(stored.calibration.model.description())
    whole = load(folder, stored.averaging_s)
    runs = [_unit(whole, segment.index, segment.name) for segment in whole.segments]
    try:
        return analysis.Prior.of(model, runs)
    except InputError as error:
        raise InputError(f"lot {record.lot}: {error}", folder) from None


def _unit(whole: Dataset, index: int, name: str) -> Dataset:
    unit, _, run = name.partition(": ")
    own = whole.select(whole.segment == index)
    return replace(own, name=run, unit=unit, segments=(), finer=None)


@dataclass(frozen=True)
class _Look:
    """What one look at one unit found."""

    at_s: float
    expected: analysis.Expected
    likeness: analysis.Likeness | None

    def told(self) -> dict[str, Any]:
        """Its figures."""
        found = self.expected
        figures = {"error_dph": found.error_dph, "low_dph": found.low_dph, "high_dph": found.high_dph}
        figures |= {"seen": found.seen, "at_s": self.at_s}
        if self.likeness is not None:
            figures |= {"level": self.likeness.level, "shape": self.likeness.shape}
        return {key: round(value, 4) for key, value in figures.items()}


class _Unit:
    """Rows of one unit so far, means over half a minute; one thread adds, another one may ask."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, float, float]] = []
        self._open: list[tuple[float, float, float]] = []
        self._lock = threading.Lock()

    def take(self, before: Dataset) -> None:
        """Take in what was recorded of the unit before its run was interrupted."""
        for row in zip(before.time, before.channel("temperature"), before.channel("rate"), strict=True):
            self.add(*map(float, row))

    def add(self, t_s: float, temperature_degc: float, rate_dph: float) -> None:
        if not (np.isfinite(temperature_degc) and np.isfinite(rate_dph)):
            return
        with self._lock:
            if self._open and t_s - self._open[0][0] >= ROW_S:
                self._rows.append(tuple(np.mean(self._open, axis=0).tolist()))
                self._open.clear()
            self._open.append((t_s, temperature_degc, rate_dph))

    def record(self, serial: str, orientation: Orientation | None) -> Dataset | None:
        with self._lock:
            rows = list(self._rows)
        if len(rows) < 2:
            return None
        time, temperature, rate = np.array(rows).T
        channels = {"temperature": temperature, "rate": rate}
        if orientation is not None:
            channels[EARTH] = earth_rate(orientation, time)
        segment = np.zeros(time.size, dtype=np.int64)
        return Dataset(serial, time, channels, segment, interval_s=ROW_S, unit=serial)


class EndingEarly:
    """Answers "go on, or stop?" for all units of a run: it ends when each is good enough, and like its lot."""

    def __init__(self, lot: Path, until: acquisition.Until, orientation: Orientation | None, *, audit: bool) -> None:
        """An `audit` goes on, and tells in the end what the others would have."""
        self._lot, self._until, self._orientation, self._audit = lot, until, orientation, audit
        self._prior = prior_of(lot)
        self._units: dict[str, _Unit] = {}
        self._good: dict[str, _Look] = {}
        """The first look at which a unit was good enough."""
        self._last: dict[str, _Look] = {}
        self._unlike: set[str] = set()
        self._next_s: float | None = None

    @classmethod
    def of(cls, job: acquisition.Job) -> EndingEarly | None:
        """What may end a run, or what is left of an interrupted one; None where it goes to its end."""
        runs = () if job.continuation is None else job.continuation.runs
        if runs:
            known = lot_of(runs[0].path)
        else:
            known = _kept(parse_yaml(job.model_texts[KEPT], KEPT).content) if KEPT in job.model_texts else None
        if known is None or job.profile.until is None or job.compensation == "on":
            return None
        lot, audit = known
        if runs and not (lot / LotRecord.FILE).is_file():
            print(f"bench: {lot}: the lot is not there any more; the run goes to its end", file=sys.stderr)
            return None
        early = cls(
            lot, job.profile.until, acquisition.stated(job.station.orientation, job.profile.orientation)[0], audit=audit
        )
        for run in (one for one in runs if one.manifest().rows):
            early._units.setdefault(run.manifest().unit, _Unit()).take(load(run.path, 1.0))
        return early

    def heard(self, serial: str, t_s: float, temperature_degc: float, rate_dph: float) -> None:
        """Take in a tick of a unit."""
        self._units.setdefault(serial, _Unit()).add(t_s, temperature_degc, rate_dph)

    def decide(self, status: acquisition.Status) -> acquisition.Continue | acquisition.Stop:
        """Look at every unit every ten minutes."""
        if self._next_s is None:
            self._next_s = status.t_s + LOOK_S
        if status.t_s < self._next_s or status.holding:
            return acquisition.Continue()
        self._next_s = status.t_s + LOOK_S
        for serial, unit in self._units.items():
            record = unit.record(serial, self._orientation)
            if record is not None:
                self._look(serial, record)
        if not self._last:
            return acquisition.Continue()
        facts = {"units": {serial: look.told() for serial, look in self._last.items()}, "limit_dph": self._limit}
        worst = max(look.expected.high_dph for look in self._last.values())
        text = f"error expected up to {worst:.3g} deg/h, limit {self._limit:g}"
        if self._unlike:
            return acquisition.Continue(
                f"goes the whole way: {', '.join(sorted(self._unlike))} unlike the lot; {text}", facts
            )
        if set(self._good) != set(self._units):
            return acquisition.Continue(f"goes on: {text}", facts)
        if self._audit:
            return acquisition.Continue(f"goes on as an audit; {text}", facts)
        return acquisition.Stop(text, WHO, facts)

    @property
    def _limit(self) -> float:
        return self._until.error_dph

    def _look(self, serial: str, record: Dataset) -> None:
        expected = self._prior.expected(record)
        good = expected.seen >= 1.0 and expected.high_dph <= self._limit
        asked = good and serial not in self._unlike and serial not in self._good
        likeness = self._prior.like(record) if asked else None
        self._last[serial] = look = _Look(float(record.time[-1] - record.time[0]), expected, likeness)
        if likeness is not None and likeness.like:
            self._good[serial] = look
        elif likeness is not None:
            self._unlike.add(serial)

    def write(self, result: acquisition.RunResult) -> None:
        """Leave until.json in the run folder of every unit that was looked at."""
        for unit in result.units:
            if unit.serial in self._last and (unit.run.path / Manifest.FILE).is_file():
                self._record(unit.serial, unit.run.path).write(unit.run.path)

    def _record(self, serial: str, folder: Path) -> UntilRecord:
        look = self._good.get(serial, self._last[serial])
        ended = Manifest.read(folder).state == "done"
        outcome = "unlike" if serial in self._unlike else "whole"
        actual = None
        if serial in self._good and not self._unlike:
            outcome = "audit" if self._audit else "stopped" if set(self._good) == set(self._units) else "whole"
        if outcome == "audit" and ended:
            actual = self._prior.error(load(folder, ROW_S), look.expected.amplitudes)
        told: Mapping[str, float] = look.told()
        return UntilRecord(
            lot=self._lot.name, limit_dph=self._limit, outcome=outcome, whole_s=self._prior.duration_s, **told,
            **({} if actual is None else {"actual_dph": actual}),
        )  # fmt: skip


def audit_due(out: Path, lot: Path, every: int) -> bool:
    """Whether so many runs of this lot ended early since the last one that went the whole way as an audit."""
    since = 0
    for record in records_of(out, lot):
        since = 0 if record.outcome == "audit" else since + (record.outcome == "stopped")
    return every > 0 and since >= every - 1


def records_of(out: Path, lot: Path) -> Iterator[UntilRecord]:
    """How the runs of a lot with `until` ended, in the order of their times."""
    for file in sorted(out.glob(f"*/*/{UntilRecord.FILE}"), key=lambda path: path.parent.name):
        record = UntilRecord.read(file.parent)
        if record.lot == lot.name:
            yield record
