"""Commands that need only a run folder or a table: report, compare, import."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench import acquisition, analysis, deliver, record
from bench.base import BenchError, InputError, NotResumableError, counted, user_name
from bench.commands.clocks import tell_ahead
from bench.commands.files import tell_unproven, write
from bench.commands.results.analyse import (
    Compared,
    ComparedSamples,
    FiguresDrawn,
    Imported,
    Reported,
    UnitsReported,
)
from bench.record import LIVE, MANIFEST, RunFolder, clear_partial, listed, of_output, open_run, rates_of, use

DEFAULT_MODELS = ("polynomial", "regression", "spline")


MODEL_FILES = "model*.yaml"


def model_file(order: int) -> str:
    """File of a run folder that keeps its first, second … model."""
    return "model.yaml" if order == 0 else f"model-{order + 1}.yaml"


def kept_models(folder: Path) -> list[analysis.Model]:
    """The models that a run folder keeps, in their order; the usual ones where it keeps none."""
    kept = {path.name for path in folder.glob(MODEL_FILES)} | {
        name for name in listed(folder) if Path(name).match(MODEL_FILES)
    }
    use(folder, *kept)
    files = [folder / name for name in sorted(kept, key=lambda name: (len(name), name))]
    return [analysis.load_model(model) for model in files or DEFAULT_MODELS]


def report(  # noqa: PLR0913, PLR0917 - options of one command
    path: Path,
    models: Sequence[str],
    check: Sequence[Path] = (),
    static: Path | None = None,
    limits: Path | None = None,
    output: str | None = None,
    sisters: Sequence[Path] = (),
) -> Reported | UnitsReported:
    """`bench report`: analyse a run again, or of a unit with several rates that of each; a killed run is recovered."""
    from bench.commands.several import report_on_outputs

    allowed = None if limits is None else analysis.load_limits(limits)
    folder = recover(path)
    refuse_lot(folder)
    chosen = [analysis.load_model(model) for model in models] if models else kept_models(folder.path)
    if output is not None:
        still = None if static is None else of_one(static, output)
        checks, others = of_outputs(check, output), of_outputs(sisters, output)
        return report_on(of_output(folder, output), chosen, None, checks, still, allowed, others)
    return report_on_outputs(folder, chosen, None, check, static, allowed, sisters)


def of_one(path: Path, output: str | None) -> Path:
    """The run folder of one output of a unit; InputError where the unit has several and none is named."""
    run = recover(path)
    if output is None and run.data.is_file() and len(rates := rates_of(run)) > 1:
        text = f"the unit has several outputs; choose one of {', '.join(rates)} with --output"
        raise InputError(text, path)
    return run.path if output is None else of_output(run, output).path


def of_outputs(paths: Sequence[Path], output: str | None) -> list[Path]:
    """The same of several runs."""
    return [of_one(path, output) for path in paths]


def figures(
    path: Path, models: Sequence[str], static: Path | None, out: Path, output: str | None = None
) -> FiguresDrawn:
    """`bench report --figures`: the figures of a run as files in `out`; the run folder stays as it is."""
    run = recover(path).path
    compared = compare([run], models, (), static, output=output)
    dataset = usual_means(recovered([run], output))[0]
    made = deliver.figure_files(dataset, compared.comparison)
    for name, content in made.items():
        write(out / name, content)
    return FiguresDrawn(run, tuple(out / name for name in made), compared.comparison.refused)


def recover(path: Path) -> RunFolder:
    """The run folder at `path`, its tables made from the journals when the bench was killed before it could.

    What the killed process left beside them goes: the file by which it was reached, and files that it wrote in part.
    """
    folder = RunFolder(path)
    if path.is_dir() and not (path / MANIFEST).exists() and any(folder.journal.glob("*.gtbj")):
        acquisition.assemble(folder)
        live = acquisition.live_at(path)
        if live is None or live.condition() == "gone":
            (path / LIVE).unlink(missing_ok=True)
            clear_partial(path)
    elif folder.journal.is_dir() and not (path / MANIFEST).exists():
        raise NotResumableError("nothing was recorded before the bench was killed; start the run anew", path)
    run = open_run(path)
    tell_unproven(path)
    return run


def refuse_lot(run: RunFolder) -> None:
    """InputError for a run folder whose calibration is that of a lot: its own rows do not give it again."""
    if run.manifest().of_lot:
        raise InputError("was calibrated by its lot; make it again with `bench lot`", run.path)


def recovered(paths: Sequence[Path], output: str | None = None) -> list[record.Dataset]:
    """1 s means of one output of each run, recovered first where they have to be.

    InputError where a unit has several outputs and none is named.
    """
    found = [record.seconds_of(recover(path).path, output) for path in paths]
    for one in found:
        if len(one.outputs) > 1:
            one.channel("rate")
    return found


def usual_means(seconds: Sequence[record.Dataset]) -> list[record.Dataset]:
    """Means over the usual interval, of 1 s means; where rows of a run are further apart, over their distance.

    InputError where a run is shorter than half of one.
    """
    interval_s = max([record.DEFAULT_INTERVAL_S, *(run.spacing_s for run in seconds)])
    means = [record.averaged(run, interval_s) for run in seconds]
    for run, mean in zip(seconds, means, strict=True):
        if len(run) and not len(mean):
            rows = counted(len(run), "row")
            raise InputError(f"{run.name}: {rows} of 1 s are too few for a mean over {interval_s:g} s: record more")
    return means


def report_on(  # noqa: PLR0913, PLR0917 - options of one command
    folder: RunFolder,
    models: Sequence[analysis.Model],
    error: BenchError | None,
    check: Sequence[Path] = (),
    static: Path | None = None,
    limits: analysis.Limits | None = None,
    sisters: Sequence[Path] = (),
) -> Reported:
    """Analyse a run, write its report, and say how it ended; its limits are those given, or those it was made with."""
    from bench.analysis import LIMITS_YAML, analyse, judged_by, load_limits

    own = folder.path / LIMITS_YAML
    use(folder.path, LIMITS_YAML, "events.jsonl")
    if limits is None and own.is_file():
        limits = load_limits(own)
    tell_ahead([(folder.path.name, folder.manifest().created)])
    analysis = analyse(folder.path, models, check, static=static, sisters=sisters)
    if limits is not None:
        analysis = judged_by(analysis, limits)
    deliver.write_report(analysis)
    return Reported(analysis, error)


def compare(
    runs: Sequence[Path],
    models: Sequence[str],
    check: Sequence[Path],
    static: Path | None = None,
    lot: bool = False,
    output: str | None = None,
) -> Compared:
    """`bench compare`: models side by side, in-sample and held-out, beside the noise floor."""
    chosen = [analysis.load_model(model) for model in models or DEFAULT_MODELS]
    seconds, still = recovered(runs, output), recovered([static] if static else [], output)
    datasets, checks = usual_means(seconds), usual_means(recovered(check, output))
    refuse = record.refuse_twice if lot else record.refuse_mixed
    refuse((*datasets, *checks, *still))
    floor_dph = floor_of(seconds, datasets[0].interval_s, still)
    # A model that nobody asked for may lack its channels; one that was asked for is an error without them.
    comparison = analysis.compare(datasets, chosen, floor_dph, checks or None, strict=bool(models), lot=lot)
    if not comparison.scores:
        raise InputError(comparison.refused[0][1], runs[0])
    return Compared(comparison)


def compare_every_sample(
    runs: Sequence[Path],
    models: Sequence[str],
    check: Sequence[Path],
    static: Path | None = None,
    lot: bool = False,
    output: str | None = None,
) -> ComparedSamples:
    """`bench compare --every-sample`: the same fitted to all samples of the runs in one pass over each."""
    from bench.record import averaged

    if check:
        raise InputError("--every-sample scores blocks and segments left out; a check run is scored on means", check[0])
    if output is not None:
        raise InputError("--every-sample reads runs of units with one output; leave --output or --every-sample out")
    chosen = [analysis.load_model(model) for model in models or DEFAULT_MODELS]
    seconds, still = recovered(runs), recovered([static] if static else [])
    fine = [averaged(run, 1.0) for run in seconds]
    samples = [analysis.Samples(open_run(path).data) for path in runs]
    records = [analysis.SampledRun(*one) for one in zip(samples, fine, usual_means(seconds), strict=True)]
    floor_dph = floor_of(seconds, 1.0, still)
    comparison = analysis.compare_every_sample(records, chosen, floor_dph, strict=bool(models), lot=lot)
    if not comparison.scores:
        raise InputError(comparison.refused[0][1], runs[0])
    means = {
        score.model.name: (analysis.of_seconds(score.rms_dph, fine), analysis.of_seconds(score.held_out.rms_dph, fine))
        for score in comparison.scores
    }
    return ComparedSamples(comparison, sum(record.samples.rows for record in records), floor_dph, means)


def floor_of(seconds: Sequence[record.Dataset], interval_s: float, static: Sequence[record.Dataset] = ()) -> float:
    """Noise floor [deg/h] of means over `interval_s` of runs, from 1 s means of them or of an isothermal run; NaN where
    nothing stands still. The number is the same for all commands.
    """
    runs, still = ([record.averaged(run, 1.0) for run in some] for some in (seconds, static))
    return analysis.noise_floor(runs, interval_s, still[0] if still else None, intervals=False).floor_dph


HOUR_S = 3600
"""Whoever imports a large file sits before it, and may end it."""


def import_table(
    file: Path,
    columns: Path | None,
    serial: str,
    dbc: Path | None,
    out: Path | None,
    memory_gb: float | None = None,
) -> Imported:
    """`bench import`: a foreign table becomes a run folder below `out`; None only tells what was understood.

    A confined process reads it, with as much memory as is given or as is free and needed.
    """
    chosen = acquisition.ColumnMap() if columns is None else acquisition.load_columns(columns)
    memory_bytes = None if memory_gb is None else int(memory_gb * 1e9)
    confines = acquisition.Confines(memory_bytes, cpu_s=4 * HOUR_S, wall_s=4 * HOUR_S, written_bytes=1 << 40)
    plan = acquisition.plan_table(acquisition.read_confined(file, dbc, confines, chosen.encoding), chosen, serial)
    return Imported(plan, None if out is None else acquisition.write_import(plan, out, operator=user_name()).path)
