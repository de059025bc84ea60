"""Commands on recorded runs: import, report, compare, diagnose, add, improve, effects, replay, diff, mysteries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bench import commands
from bench.cli import completion
from bench.cli.options import (
    answers,
    effect_option,
    limits_option,
    model_argument,
    model_option,
    out_option,
    output_option,
    path_argument,
    path_option,
    quiet_option,
    registers,
    run_argument,
    runs_argument,
    sister_option,
    station_option,
    unseen_options,
)


@click.command()
@runs_argument
@model_option
@effect_option
@unseen_options
@click.option("--every-sample", is_flag=True, help="Fit every sample, in one pass over the run, instead of its means.")
@click.option("--lot", is_flag=True, help="One fit to runs of several units, which are refused otherwise.")
@output_option
@answers
def compare(every_sample: bool, check_runs: tuple[Path, ...], **options: Any) -> commands.Result:
    """Compare models with the measurement: in-sample and held-out error of each, and the noise floor."""
    compare = commands.compare_every_sample if every_sample else commands.compare
    return compare(check=check_runs, **options)


@click.command()
@runs_argument
@output_option
@answers
def noise(runs: tuple[Path, ...], output: str | None) -> commands.Result:
    """The noise of RUN where its temperature stands still: Allan deviation, N, B, K, Q and R with 95 % intervals.

    A record of some hours at one temperature (profiles/static_25.yaml) tells B and K; the soaks of a ramp mostly N.
    """
    return commands.noise(runs, output)


@click.command()
@run_argument
@model_option
@effect_option
@unseen_options
@sister_option
@limits_option
@path_option("--figures", help="Instead: draw the figures as SVG and PNG, with their data as CSV, into this folder.")
@output_option
@answers
@registers(begin=False)
def report(run_folder: Path, figures: Path | None, check_runs: tuple[Path, ...], **options: Any) -> commands.Result:
    """Analyse RUN again and write its report; a killed run is recovered from its journals first.

    A unit with several rates gets a report of each, in a run folder of its own beside RUN: RUN_rate_x and so on.

    The diagnosis is repeated with the given --static, --sister and --check runs and saved as diagnosis.json. An earlier
    one that used more runs is kept as diagnosis-before.json, and the report states this.
    """
    if figures is not None:
        if check_runs or options.pop("sisters") or options.pop("limits") is not None:
            raise click.UsageError("--figures draws the run and its models; it takes no --check, --sister or --limits")
        return commands.figures(run_folder, out=figures, **options)
    return commands.report(run_folder, check=check_runs, **options)


@click.command()
@runs_argument
@click.option(
    "--model", "models", multiple=True, help="Model of its analysis that the run folder does not contain; repeatable."
)
@path_option("--with", "others", multiple=True, help="Further run of its analysis.")
@effect_option
@answers
def replay(runs: tuple[Path, ...], models: tuple[str, ...], others: tuple[Path, ...]) -> commands.Result:
    """Recompute the numbers of each RUN from its raw frames, and list differences; exit code 1 if a bit differs."""
    return commands.replay_runs(runs, models, others)


@click.command()
@path_argument("a", metavar="A")
@path_argument("b", metavar="B")
@effect_option
@answers
def diff(a: Path, b: Path) -> commands.Result:
    """List differences between the runs A and B, of one unit or of two: settings, coefficients, residuals, curves."""
    return commands.diff(a, b)


@click.command("import")
@path_argument("file")
@path_option("--columns", help="Column map (YAML): columns and their units.")
@click.option("--unit", "serial", default="unknown", show_default=True, help="Serial number of the unit.")
@path_option("--dbc", help="Layout of a CAN log (BLF, ASC).")
@click.option("--preview", is_flag=True, help="Only show how FILE is interpreted; write nothing.")
@click.option(
    "--memory", "memory_gb", type=click.FloatRange(0.4), metavar="GB",
    help="Memory that reading the file may take [default: 1, or 32 bytes for each of the file's, or what is free].",
)  # fmt: skip
@out_option
@answers
@registers(begin=True)
def import_(out: Path, preview: bool, **options: Any) -> commands.Result:
    """Make a run folder from a FILE of another program: CSV, XLSX, Parquet, MF4, TDMS, ULog, HDF5, BLF or ASC."""
    return commands.import_table(out=None if preview else out, **options)


@click.command()
@runs_argument
@model_argument
@unseen_options
@sister_option
@path_option("--plan", help="Write the profile that separates look-alikes here.")
@click.option(
    "--surface",
    metavar="CHANNEL,CHANNEL",
    help="Show what is left in cells of two channels, such as temperature,rate_of_temperature.",
)
@effect_option
@output_option
@answers
@registers(begin=False)
def diagnose(check_runs: tuple[Path, ...], **options: Any) -> commands.Result:
    """Find where the model fails, which physical effect is missing, and which experiment would show it."""
    return commands.diagnose(check=check_runs, **options)


@click.command()
@runs_argument
@model_argument
@unseen_options
@sister_option
@station_option
@click.option("--most", type=click.IntRange(1, 20), default=3, show_default=True, help="Further runs that it may make.")
@effect_option
@out_option
@quiet_option
@answers
@registers(begin=True)
def decide(check_runs: tuple[Path, ...], **options: Any) -> commands.Result:
    """Diagnose, run the profile that the diagnosis proposes, and diagnose all runs together, until it is decided."""
    return commands.decide(check=check_runs, **options)


@click.command()
@click.argument("effect", nargs=-1, required=True, shell_complete=completion.effects)
@model_argument
@path_option("--out", required=True, help="The new model file.")
@effect_option
@answers
def add(effect: tuple[str, ...], model: str, out: Path) -> commands.Result:
    """Write a model with one more EFFECT, or several; `bench compare` then shows whether the error decreases.

    EFFECT is a name of `bench effects`, a formula such as "k * dT_dt * quadrature", or what `bench diagnose` writes of
    a formula that it found.
    """
    return commands.add(effect, model, out)


@click.command()
@click.argument("action", type=click.Choice(["list", "show"]), default="list")
@click.argument("name", required=False, shell_complete=completion.effects)
@effect_option
@answers
def effects(action: str, name: str | None) -> commands.Result:
    """List the physical effects; `show NAME` explains and draws one."""
    if (action == "show") != (name is not None):
        raise click.UsageError("`bench effects` lists all, `bench effects show NAME` explains one")
    return commands.effects() if name is None else commands.show_effect(name)


@click.command()
@runs_argument
@model_argument
@unseen_options
@path_option("--out", help="Write the final model here.")
@effect_option
@answers
def improve(
    runs: tuple[Path, ...],
    check_runs: tuple[Path, ...],
    static: Path | None,
    model: str,
    out: Path | None,
) -> commands.Result:
    """Improve the model unattended: diagnose, add, test on unseen data, until the error decreases no further."""
    return commands.improve(runs, check_runs, static, model, out)


@click.command()
@click.option("--seed", type=click.IntRange(0), help="The same seed gives the same unit; default: random.")
@click.option(
    "--effects", "count", type=click.IntRange(1), default=1, show_default=True, help="Number of hidden effects."
)
@path_option("--out", default=Path("mystery"), show_default=True, help="Folder of the runs and the envelope.")
@answers
def mystery(seed: int | None, count: int, out: Path) -> commands.Result:
    """Record a simulated unit with hidden effects: a run, a check run and an isothermal run."""
    return commands.mystery(seed, count, out)


@click.command()
@path_argument("folder")
@model_argument
@effect_option
@answers
def reveal(folder: Path, model: str) -> commands.Result:
    """Open the envelope of a mystery in FOLDER and score your model against the truth."""
    return commands.reveal(folder, model)


@click.command()
@path_argument("sources", nargs=-1, required=True)
@path_option("--plan", "plan_file", help="Plan (YAML): place and attitudes of a table; options of the fit for runs.")
@path_option(
    "--out", help="Folder for record, parameters and report; or a file: .json the record, .csv the parameters."
)
@click.option("--unit", default="", help="Serial number of the unit, for record and image.")
@path_option("--verify", "calibration", help="Instead: judge this calibration (folder or imu.json) by SOURCES.")
@limits_option
@answers
@registers(begin=False)
def imu(
    sources: tuple[Path, ...],
    plan_file: Path | None,
    out: Path | None,
    unit: str,
    calibration: Path | None,
    limits: Path | None,
) -> commands.Result:
    """Calibrate a whole inertial unit: three gyros and three accelerometers over temperature.

    SOURCES are run folders, which know their attitudes, or one table with --plan. A table has the channels time,
    rate_x … acceleration_z, temperatures and applied_rate, as CSV, Parquet or MF4. Exit code 1 where outputs, fixture,
    place or the model of an axis are not as they should be, or, with --verify, where the calibration is outside its
    limits.
    """
    if calibration is not None:
        if out is not None or unit:
            raise click.UsageError("--verify calibrates nothing: leave out --out and --unit")
        return commands.verify_imu(sources, plan_file, calibration, limits)
    if limits is not None:
        raise click.UsageError("--limits judges a verification: name the calibration with --verify")
    return commands.imu(sources, plan_file, out, unit)
