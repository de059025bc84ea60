"""Going on with a run whose bench was killed: what is left of its profile, and from where.

A ramp is never rewound: it goes on towards its target from where the chamber air was when the record ended; a soak
goes on for what is left of it; a leg whose point is to settle, or to turn at a rate, is done again whole. Before, the
chamber is taken back to that temperature and settles there. What is recorded from now on is a part of its own in the
same folder, on the same bench time; the gap stays a gap (docs/decisions/0005-parts-of-a-run.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from bench.acquisition.profile.legs import STEP_DEGC_PER_MIN, Leg
from bench.acquisition.profile.profile import Profile
from bench.acquisition.recording import parts
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.recording.journals import BenchJournal, read_bench
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.base import THERMOMETERS, InputError, LeftRunError, NotResumableError, finite
from bench.record import LAYOUT, MANIFEST, ExecutedSegment, RunFolder, open_run
from drivers.chamber import ChamberReading
from drivers.journal import Damage

RESUMED = "(resumed)"
SIMULATED_GAP_S = 3600.0
"""A simulated chamber begins anew, at ambient, as after an hour without power; its units have kept theirs."""
CLOCK_BEHIND_S = 1.0
"""A gap of this length [s] stands for one of unknown length: the calendar clock is not ahead of the record."""
WATCHDOG_S = 60.0
"""A watchdog whose last word is younger than this, and not its final one, is still at work."""


@dataclass(frozen=True)
class Continuation:
    """How to go on with a run."""

    runs: tuple[RunFolder, ...]
    """The new part in the folder of each unit that is still with the run."""
    serials: tuple[str, ...]
    identities: Mapping[str, int]
    """Serial number that each unit said in its heartbeat before."""
    layouts: Mapping[str, str]
    """The DBC of each unit before."""
    legs: tuple[Leg, ...]
    zero: datetime
    """UTC of bench time 0."""
    ended_s: float
    """Bench time of the last record before the gap [s]."""
    before: Mapping[str, Any]
    """Chamber and units at that time."""
    power_ons: Mapping[str, int]
    """How often each simulated unit had been powered by then, by serial number: it has kept its power since."""

    def start_s(self, simulated: bool, now: datetime | None = None) -> float:
        """Bench time at which the new part begins: calendar time since the start of the run [s]."""
        if simulated:
            return self.ended_s + SIMULATED_GAP_S
        passed_s = ((now or datetime.now(UTC)) - self.zero).total_seconds()
        return max(passed_s, self.ended_s + CLOCK_BEHIND_S)

    def open(self, station_text: str) -> tuple[RunFolder, ...]:
        """Make room for the new part in the run folders; InputError when it cannot be written.

        Tables and manifest are those of a part from now on, so the manifest goes, as if the bench had been killed
        again: whoever finds the folder in that state makes the tables from all journals.
        """
        try:
            for run in self.runs:
                run.journal.mkdir()
                (run.path / MANIFEST).unlink(missing_ok=True)
                if (run.path / "station.yaml").read_text(encoding="utf-8") != station_text:
                    (run.path / f"station-{run.part}.yaml").write_text(station_text, encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}; nothing was moved", self.runs[0].path) from None
        return self.runs

    def units(self, station: StationSettings) -> StationSettings:
        """The station with its units expected to be the same as before."""

        def same(unit: UnitSettings) -> UnitSettings:
            known, layout = self.identities.get(unit.serial), self.layouts.get(unit.serial)
            update: dict[str, Any] = {} if known is None or unit.identity is not None else {"identity": known}
            moved = unit.dbc is not None and not Path(unit.dbc).is_file()  # it was beside the station file
            if layout and unit.dbc is not None and (moved or Path(layout).name == LAYOUT):
                update["gyro"] = layout
            return unit.model_copy(update=update) if update else unit

        return station.model_copy(update={"units": tuple(same(unit) for unit in station.units)})

    def gap(self, start_s: float, reading: ChamberReading, unit_degc: Mapping[str, float | None]) -> dict[str, Any]:
        """What is known of the gap up to `start_s` and what was found after it: facts of an event, and its `text`."""
        duration_s = start_s - self.ended_s
        after = {**_chamber(reading), "units_degc": dict(unit_degc)}
        text = f"{duration_s:.0f} s without a record: chamber {_say(self.before)}, now {_say(after)}"
        known = duration_s > CLOCK_BEHIND_S
        if not known:
            text = f"without a record for an unknown time (the calendar clock runs behind): {text}"
        return {
            "text": text,
            "from_s": round(self.ended_s, 3),
            "to_s": round(start_s, 3),
            "duration_s": round(duration_s, 3),
            "duration_known": known,
            "before": dict(self.before),
            "after": after,
        }


def plan(run: RunFolder, profile: Profile, station: StationSettings) -> Continuation:
    """How to go on with the run in a folder; NotResumableError or LeftRunError where nothing is left of it."""
    journals = _journals(run)
    last = journals[-1]
    end = last.end()
    if end is not None and end["state"] == "done":
        text = "this run went to its end: nothing to resume; `bench report` analyses it again"
        raise NotResumableError(text, run.path)
    if end is not None and "sound_until_s" in end:
        raise LeftRunError(f"this unit left the run ({end['text']}); resume that of a unit that stayed", run.path)
    _refuse_busy_watchdog(run, last)
    folders = [run, *_companions(run, last)]
    ended_s = max((_last_s(journal) for journal in journals), default=0.0)
    readings = [journal.readings for journal in journals if len(journal.readings)]
    here = station.ambient_degc if not readings else float(readings[-1]["temperature"][-1])
    low, high = station.chamber.lowest_degc, station.chamber.highest_degc
    done = parts.segments(journals)
    legs = remaining(profile, done, round(min(max(here, low), high), 1))
    if not legs:
        raise NotResumableError(
            "all segments of its profile are done: nothing to resume; `bench report` analyses it", run.path
        )
    metas = [_journals(folder)[0].meta for folder in folders]
    cycles = sum(segment.kind == "power_cycle" for segment in done)
    known = {meta.unit: _recovered(folder) for meta, folder in zip(metas, folders, strict=True)}
    chamber = _chamber_of(readings[-1]) if readings else {}
    return Continuation(
        runs=tuple(replace(folder, part=len(folder.parts()) + 1) for folder in folders),
        serials=tuple(known),
        identities={serial: unit.identity for serial, unit in known.items() if unit.identity is not None},
        layouts={
            meta.unit: str(own) if (own := folder.path / LAYOUT).is_file() else meta.gyro.layout
            for meta, folder in zip(metas, folders, strict=True)
            if meta.gyro is not None
        },
        legs=tuple(legs),
        zero=_zero(journals[0], run.path),
        ended_s=ended_s,
        before={**chamber, "units_degc": {serial: unit.degc for serial, unit in known.items()}},
        power_ons={meta.unit: meta.power_on + cycles for meta in metas if meta.power_on is not None},
    )


def remaining(profile: Profile, segments: Sequence[ExecutedSegment], here_degc: float) -> list[Leg]:
    """Legs that are still to be run, after the executed `segments`; the chamber air was at `here_degc` at last."""
    legs = profile.legs()
    at, mine = _position(legs, segments)
    if at == len(legs):
        return []
    leg, rest = legs[at], list(legs[at + 1 :])
    if not segments or leg.kind == "step":  # a step goes to its temperature by itself, wherever the chamber is
        return [replace(leg, name=f"{leg.name} {RESUMED}") if mine else leg, *rest]
    if leg.kind != "ramp":
        here_degc = leg.target_degc
    begun = rest_of(leg, here_degc, mine) if mine else leg
    return [_back(profile, begun, here_degc), begun, *rest]


def _position(legs: Sequence[Leg], segments: Sequence[ExecutedSegment]) -> tuple[int, list[ExecutedSegment]]:
    """The leg that is not done yet, and the segments in which it was begun; others than legs count for none."""
    at = 0
    mine: list[ExecutedSegment] = []
    for segment in segments:
        if at == len(legs):
            break
        name = legs[at].name
        if segment.name != name and not segment.name.startswith(f"{name} {RESUMED}"):
            continue
        mine.append(segment)
        if segment.outcome in {"done", "timeout"}:
            at, mine = at + 1, []
    return at, mine


def rest_of(leg: Leg, here_degc: float, begun: Sequence[ExecutedSegment] = ()) -> Leg:
    """What is left of a ramp, a soak or a turn at a rate that was begun."""
    share = 1.0
    if leg.kind == "ramp" and leg.target_degc != leg.from_degc:
        share = abs(leg.target_degc - here_degc) / abs(leg.target_degc - leg.from_degc)
    elif leg.kind == "soak" and leg.duration_s > 0:
        held = [i for i, segment in enumerate(begun) if segment.outcome == "held"]  # a hold starts a soak anew
        counted = begun[held[-1] + 1 :] if held else begun
        elapsed_s = sum(segment.to_s - segment.from_s for segment in counted)
        share = max(1.0 - elapsed_s / leg.duration_s, 0.0)
    nominal_s = share * leg.nominal_s
    return replace(
        leg,
        name=f"{leg.name} {RESUMED}",
        duration_s=share * leg.duration_s,
        move_s=share * leg.move_s,
        nominal_s=nominal_s,
        nominal_start_s=leg.nominal_end_s - nominal_s,
    )


def _back(profile: Profile, leg: Leg, here_degc: float) -> Leg:
    """The way back to where the record ended: go there and settle."""
    move_s = 60.0 * abs(here_degc - leg.from_degc) / STEP_DEGC_PER_MIN
    nominal_s = move_s + profile.settle.dwell_s
    return Leg(
        index=leg.index,
        name=f"back to {here_degc:g} {RESUMED}",
        kind="step",
        from_degc=leg.from_degc,
        target_degc=here_degc,
        timeout_s=move_s + 60.0 * profile.settle.timeout_min,
        nominal_start_s=leg.nominal_start_s - nominal_s,
        nominal_s=nominal_s,
        settle=profile.settle,
        move_s=move_s,
        attitude=leg.attitude,
    )


@dataclass(frozen=True)
class _Unit:
    degc: float | None
    identity: int | None


def _recovered(run: RunFolder) -> _Unit:
    """The last temperature and the identity of a unit before the gap; makes its tables where the bench could not."""
    manifest = assemble(run) if not (run.path / MANIFEST).exists() else open_run(run.path).manifest()
    own = next(name for name in THERMOMETERS if name in pq.read_schema(run.means).names)
    known = pq.read_table(run.means, columns=[own])[own].drop_null()
    identity = manifest.unit_identity
    return _Unit(float(known[-1].as_py()) if len(known) else None, None if identity is None else identity.serial)


def _journals(run: RunFolder) -> list[BenchJournal]:
    return parts.apart([read_bench(part, Damage()) for part in parts.recorded(run)])


def _companions(run: RunFolder, journal: BenchJournal) -> Iterator[RunFolder]:
    """Folders of the units in the same chamber that were still with the run."""
    for companion in journal.meta.companions:
        folder = RunFolder((run.path / companion.run).resolve())
        end = _journals(folder)[-1].end()
        if end is None or "sound_until_s" not in end:
            yield folder


def _refuse_busy_watchdog(run: RunFolder, journal: BenchJournal) -> None:
    said = journal.watchdog[-1] if journal.watchdog else None
    if said is None or "took_s" in said or "utc" not in said:
        return
    age_s = (datetime.now(UTC) - datetime.fromisoformat(said["utc"])).total_seconds()
    if age_s < WATCHDOG_S:
        text = f"the watchdog is still making the equipment safe ({said['text']}); resume when it is done"
        raise InputError(text, run.path)


def _last_s(journal: BenchJournal) -> float:
    times = [float(event["t_s"]) for event in journal.events[-1:]]
    return max(times + [float(t_s) for t_s in journal.readings["t_s"][-1:]], default=0.0)


def _zero(journal: BenchJournal, path: Path) -> datetime:
    for event in journal.events:
        return datetime.fromisoformat(event["utc"]) - timedelta(seconds=float(event["t_s"]))
    raise NotResumableError("nothing was recorded before the bench was killed; start the run anew", path)


def _chamber(reading: ChamberReading) -> dict[str, Any]:
    return {
        "chamber_degc": finite(reading.temperature, 3),
        "setpoint_degc": finite(reading.setpoint, 3),
        "on": reading.on,
    }


def _chamber_of(readings: Any) -> dict[str, Any]:
    last = readings[-1]
    on = bool(last["on"])
    return {"chamber_degc": finite(last["temperature"], 3), "setpoint_degc": finite(last["setpoint"], 3), "on": on}


def _say(state: Mapping[str, Any]) -> str:
    if "chamber_degc" not in state:
        return "not known"
    units = ", ".join(f"{serial} {_degc(value)}" for serial, value in state["units_degc"].items())
    mode = "on" if state["on"] else "off"
    return f"{_degc(state['chamber_degc'])} ({mode}, set point {_degc(state['setpoint_degc'])}; {units})"


def _degc(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.1f} degC"
