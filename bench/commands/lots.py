"""`bench lot`: one calibration for a lot of units, and whether a unit is like its lot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from bench import acquisition, analysis
from bench.base import FloatArray, InputError, __version__, finite
from bench.commands.acquisition import load_station
from bench.commands.analysis import recovered, usual_means
from bench.commands.files import write
from bench.commands.results.stock import LotAudited, LotCalibrated, LotChecked, LotCompleted, LotPlanned
from bench.record import (
    EVENTS,
    CalibrationRecord,
    Dataset,
    ExecutedSegment,
    LotRecord,
    LotUnit,
    Manifest,
    RunFolder,
    create_run,
    load,
    slug,
    write_events,
    write_means,
    write_samples,
)

OUTCOMES = ("stopped", "audit", "unlike", "whole")
BETWEEN_S = 864_000.0
"""Between two runs in the record of a lot: effects with memory begin anew after ten days."""


def calibrate_lot(runs: Sequence[Path], lot: str, model: str, out: Path) -> LotCalibrated:
    """`bench lot calibrate`: one model for all units of these runs, as a run folder of the lot."""
    wanted = analysis.load_model(model)
    records = usual_means(recovered(runs))
    found = analysis.calibrate_lot(wanted, records)
    run = _folder(records, lot, [Manifest.read(path) for path in runs], out)
    whole = load(run.path, records[0].interval_s)
    CalibrationRecord.model_validate(found.calibration(run.manifest(), whole)).write(run.path)
    record = _record(found, lot, wanted.name, [path.name for path in runs])
    record.write(run.path)
    return LotCalibrated(run.path, record)


def audits(folder: Path, out: Path) -> LotAudited:
    """`bench lot audits`: what runs that ended early saved, and whether the audits bear their stated errors out."""
    import scipy

    from bench.commands.ending_early import records_of

    found = list(records_of(out, folder))
    if not found:
        raise InputError(f"holds no run with `until` of the lot {folder.name}", out)
    measured = [one for one in found if one.actual_dph is not None]
    held = sum(one.low_dph <= (one.actual_dph or 0.0) <= one.high_dph for one in measured)
    share = scipy.stats.binomtest(held, len(measured)).proportion_ci(0.95) if measured else None
    saved = sum(max(one.whole_s - one.at_s, 0.0) for one in found if one.outcome == "stopped")
    return LotAudited(
        lot=folder.name,
        outcomes={word: sum(one.outcome == word for one in found) for word in OUTCOMES},
        saved=saved / sum(one.whole_s for one in found),
        audits=len(measured),
        held=held,
        held_from=None if share is None else float(share.low),
        held_to=None if share is None else float(share.high),
        over=sum((one.actual_dph or 0.0) > one.limit_dph for one in measured),
    )


def plan_lot(folder: Path, target_dph: float, profile: Path | None, station: Path | None = None) -> LotPlanned:
    """`bench lot plan`: the shortest profile after which a further unit's error is within the target, as a file.

    Rates are those of the lot's runs, or up to those of a station's chamber. InputError where no plan is.
    """
    from bench.commands.ending_early import prior_of

    prior, lot = prior_of(folder), LotRecord.read(folder)
    fastest = None
    if station is not None:
        chamber, ends = load_station(station).limits(), prior.cells.borders
        fastest = _throughout(chamber.heating, ends), _throughout(chamber.cooling, ends)
    try:
        found = analysis.shortest(prior, target_dph, fastest)
    except InputError as error:
        raise InputError(f"lot {lot.lot}: {error}", folder) from None
    path = profile or Path(f"short_{slug(lot.lot)}.yaml")
    text = found.to_yaml(lot.lot, len(lot.units))
    write(path, text)
    return LotPlanned(
        lot=lot.lot,
        profile=path,
        target_dph=target_dph,
        error_dph=found.error_dph,
        low_dph=found.low_dph,
        high_dph=found.high_dph,
        hours=acquisition.profile_from_text(text).duration_s / 3600.0,
        whole_hours=found.whole_s / 3600.0,
    )


def _throughout(rate: float | Sequence[tuple[float, float]], range_degc: FloatArray) -> float:
    """The rate [degC/min] that a chamber keeps throughout a range; its own may be a curve over temperature."""
    if not isinstance(rate, Sequence):
        return rate
    degc, rates = np.array(rate).T
    inside = np.concatenate([degc[(degc > range_degc[0]) & (degc < range_degc[-1])], range_degc])
    return float(np.interp(inside, degc, rates).min())


def complete_unit(folder: Path, run: Path, out: Path) -> LotCompleted:
    """`bench lot complete`: the calibration of a unit by its run and its lot, as a run folder of the unit.

    InputError where the run does not go through all temperatures of the lot, or the unit is unlike it.
    """
    from bench.commands.ending_early import prior_of

    prior, lot = prior_of(folder), LotRecord.read(folder).lot
    own = usual_means(recovered([run]))[0]
    seen, likeness = prior.expected(own).seen, prior.like(own)
    if seen < 1.0:
        raise InputError(f"the run was in {100 * seen:.0f} % of the temperatures of lot {lot}; all are needed", run)
    if likeness is None or not likeness.like:
        raise InputError(f"unit {own.unit} is unlike lot {lot}; give it the whole run and calibrate it by itself", run)
    made = _folder([own], own.unit, [Manifest.read(run)], out)
    found, content = analysis.completed(prior, lot, load(made.path, own.interval_s), made.manifest())
    CalibrationRecord.model_validate(content).write(made.path)
    return LotCompleted(made.path, lot, found.error_dph, found.low_dph, found.high_dph)


def check_lot(folder: Path, runs: Sequence[Path]) -> LotChecked:
    """`bench lot check`: whether the unit of each run is like the lot."""
    units = analysis.by_unit(usual_means(recovered(runs)))
    return LotChecked(folder, LotRecord.read(folder).lot, _likeness(folder, units))


def refuse_unlike(folder: Path, serial: str, run: Path | None) -> None:
    """InputError where no run shows that a unit is like the lot whose calibration stands in this folder."""
    if run is None:
        text = f"is the calibration of a lot: show with --check RUN that unit {serial} is like it"
        raise InputError(text, folder)
    own = usual_means(recovered([run]))
    if own[0].unit != serial:
        raise InputError(f"is a run of unit {own[0].unit}, this is unit {serial}", run)
    one = _likeness(folder, {serial: own})[serial]
    if not one.like:
        raise InputError(
            f"unit {serial} is unlike its lot: {one.sigmas:.1f} standard deviations off at {one.worst_degc:.0f} degC "
            f"(level {one.level:.2g}, shape {one.shape:.2g} of the limit); calibrate it by itself",
            folder,
        )


def _likeness(folder: Path, units: Mapping[str, Sequence[Dataset]]) -> dict[str, analysis.Likeness]:
    record = LotRecord.read(folder)
    cells = analysis.Cells(np.array(record.borders_degc))
    table = np.array([unit.cells_dph for unit in record.units], dtype=np.float64)
    found = analysis.likeness(table, cells, [cells.means(own) for own in units.values()])
    return dict(zip(units, found, strict=True))


def _record(found: analysis.Lot, lot: str, model: str, runs: Sequence[str]) -> LotRecord:
    units = tuple(
        LotUnit(
            unit=loss.unit,
            own_rms_dph=loss.own_rms_dph,
            lot_rms_dph=loss.lot_rms_dph,
            levelled_rms_dph=loss.levelled_rms_dph,
            cells_dph=tuple(finite(value) for value in row),
        )
        for loss, row in zip(found.losses, found.table.tolist(), strict=True)
    )
    borders = tuple(found.cells.borders.tolist())
    return LotRecord(lot=lot, model=model, runs=tuple(runs), borders_degc=borders, units=units)


def _folder(records: Sequence[Dataset], lot: str, manifests: Sequence[Manifest], out: Path) -> RunFolder:
    """A run folder whose rows are the means of all runs, one after the other, each run a segment."""
    now = datetime.now(UTC)
    run = create_run(out, lot, "lot", now)
    run.journal.rmdir()
    columns, segments = _rows(records)
    write_samples(run.data, columns)
    write_means(run.data, run.means)
    write_events(run.path / EVENTS, [{"t_s": 0.0, "kind": "lot", "text": f"runs of {len(records)} units or visits"}])
    Manifest(
        run=run.path.name,
        unit=lot,
        created=now.isoformat(timespec="seconds"),
        profile="lot",
        state="done",
        cause="calibrated as a lot",
        simulated=any(manifest.simulated for manifest in manifests),
        sample_rate_hz=1.0 / records[0].interval_s,
        rows=columns["time"].size,
        duration_s=sum(segment.to_s - segment.from_s for segment in segments),
        segments=segments,
        versions={"bench": __version__},
        files=run.hashes(),
    ).write(run.path)
    return run


def _rows(records: Sequence[Dataset]) -> tuple[dict[str, FloatArray], tuple[ExecutedSegment, ...]]:
    names = set.intersection(*(set(record.channels) for record in records))
    start, times, segments = 0.0, [], []
    for index, record in enumerate(records):
        time = record.time - record.time[0] + 0.5 * record.interval_s + start
        times.append(time)
        end = float(time[-1]) + 0.5 * record.interval_s
        name = f"{record.unit}: {record.name}"
        segments.append(ExecutedSegment(index=index, name=name, kind="lot", from_s=start, to_s=end))
        start = end + BETWEEN_S
    columns = {name: np.concatenate([record.channels[name] for record in records]) for name in sorted(names)}
    segment = np.repeat(np.arange(len(records), dtype=np.int16), [len(record) for record in records])
    return {"time": np.concatenate(times), **columns, "segment": segment}, tuple(segments)
