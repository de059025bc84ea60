"""Commands on many units: registry and fleet."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench import commands
from bench.cli import completion
from bench.cli.options import (
    RUN,
    answer,
    answers,
    archive_options,
    effect_option,
    fetched,
    json_option,
    model_argument,
    out_option,
    path_argument,
    path_option,
    runs_argument,
    shelf_options,
    together,
)

if TYPE_CHECKING:
    from bench import archive


@click.group()
def registry() -> None:
    """Index of units, runs, calibrations and equipment; the run folders remain authoritative."""


@registry.command("list")
@click.option("--unit", shell_complete=completion.units, help="Only runs of this unit.")
@click.option("--most", type=click.IntRange(1), default=50, show_default=True, help="Newest runs to list.")
@shelf_options
@answers
def registry_list(unit: str | None, most: int, out: Path, where: str | None) -> commands.Result:
    """List the runs, newest first, with the verdicts of their calibrations."""
    return commands.registry_list(out, where, unit, most)


@registry.command("show")
@click.argument("name", metavar="UNIT|RUN")
@shelf_options
@answers
def registry_show(name: str, out: Path, where: str | None) -> commands.Result:
    """Show all data of a unit or a run."""
    return commands.registry_show(out, where, name)


@registry.command("rebuild")
@click.option("--check", "only_compare", is_flag=True, help="Change nothing; exit code 1 if rows differ.")
@click.option("--moved", is_flag=True, help="The folder was moved: the registry knows it at another place.")
@click.option("--copied", is_flag=True, help="The folder is a copy, as on a cloned disk: give it an id of its own.")
@archive_options
@answers
def registry_rebuild(only_compare: bool, moved: bool, copied: bool, out: Path, where: str | None) -> commands.Result:
    """Rebuild the rows from the run folders, list the differences, and verify that they are equal."""
    if moved + copied + only_compare > 1:
        raise click.UsageError("choose one of --check, --moved and --copied")
    return commands.registry_rebuild(out, where, only_compare, moved, copied)


@registry.command("lot")
@click.argument("lot")
@click.argument("serials", nargs=-1, required=True)
@archive_options
@answers
def registry_lot(lot: str, serials: tuple[str, ...], out: Path, where: str | None) -> commands.Result:
    """Assign the units SERIALS to LOT."""
    entry = {"kind": "lot", "lot": lot, "units": list(serials)}
    return commands.registry_tell(out, where, entry)


@registry.command("operator")
@click.argument("name")
@archive_options
@answers
def registry_operator(name: str, out: Path, where: str | None) -> commands.Result:
    """Add an operator."""
    return commands.registry_tell(out, where, {"kind": "operator", "name": name})


@registry.command("certificates")
@click.option("--unit", shell_complete=completion.units, help="Only those of this unit.")
@shelf_options
@answers
def registry_certificates(unit: str | None, out: Path, where: str | None) -> commands.Result:
    """List the certificates: in force, replaced or withdrawn."""
    return commands.registry_certificates(out, where, unit)


@registry.command("recall")
@click.argument("equipment")
@click.option("--since", type=click.DateTime(["%Y-%m-%d"]), help="Only runs from this day on. Default: all.")
@shelf_options
@answers
def registry_recall(equipment: str, since: datetime | None, out: Path, where: str | None) -> commands.Result:
    """List runs, units and certificates that rest on EQUIPMENT, given by its name or serial number."""
    return commands.registry_recall(out, where, equipment, None if since is None else since.date())


@registry.group("equipment")
def registry_equipment() -> None:
    """Chambers, sensors, rate tables, time bases, and the due dates of their calibrations."""


@registry_equipment.command("add")
@click.argument("name")
@click.argument("serial")
@click.option("--kind", required=True, help="chamber, sensor, rate table or time base.")
@click.option("--calibrated", type=click.DateTime(["%Y-%m-%d"]), help="Day of its last calibration.")
@click.option("--due", type=click.DateTime(["%Y-%m-%d"]), help="Last day on which that calibration is valid.")
@archive_options
@answers
def registry_equipment_add(name: str, serial: str, out: Path, where: str | None, **given: Any) -> commands.Result:
    """Add a piece of equipment, or its new calibration."""
    return commands.add_equipment(out, where, name, serial, **given)


@registry_equipment.command("list")
@click.option("--on", type=click.DateTime(["%Y-%m-%d"]), help="Day to judge by. Default: today.")
@archive_options
@answers
def registry_equipment_list(on: datetime | None, out: Path, where: str | None) -> commands.Result:
    """List the equipment by due date; exit code 1 if a calibration is overdue."""
    return commands.registry_equipment(out, where, (on or datetime.now()).date())


@click.command("verify-archive")
@out_option
@answers
def verify_archive(out: Path) -> commands.Result:
    """Read every file of an archive, and say each that is not what the bench wrote; exit code 1 where there is one."""
    return commands.verify_archive(out)


which_options = together(
    click.option("--profile", help="Only runs of this profile. Default: the one that most calibrated units have run."),
    click.option(
        "--simulated/--real",
        default=None,
        help="Simulated runs alone, or none of them. Default: they count only where there are no others.",
    ),
)


def _selection(options: dict[str, Any]) -> archive.Selection:
    """What `which_options` say, taken out of the options."""
    from bench.archive import Selection

    return Selection(options.pop("profile"), simulated=options.pop("simulated"))


engine_options = together(
    click.option(
        "--engine",
        type=click.Choice(["auto", "serial", "pool", "dask"]),
        default="auto",
        show_default=True,
        help="On this computer in one process (serial) or several (pool), or on a Dask cluster (dask).",
    ),
    click.option("--workers", type=click.IntRange(1), help="Processes. Default: one per processor."),
    click.option("--scheduler", metavar="tcp://…", help="A running Dask cluster. Default: a local one."),
)


@click.group(invoke_without_command=True)
@click.option("--unit-filter", "pattern", metavar="REGEX", help="Only units whose whole serial matches.")
@which_options
@path_option("--limits", help="Limits file (YAML): yield and Cpk are against it.")
@path_option("--html", help="Write the page here.")
@path_option("--csv", help="Write one line per unit and quantity here.")
@shelf_options
@json_option
@click.pass_context
def fleet(context: click.Context, /, as_json: bool, **options: Any) -> None:
    """Statistics of many units: first-pass yield, Cpk, control charts, drift of stations and lots, outliers in lots."""
    if context.invoked_subcommand is None:
        from bench import commands

        answer(lambda: commands.fleet(selection=_selection(options), **fetched(options)), as_json)


@fleet.command("gauge")
@click.argument("quantity")
@click.option("--unit-filter", "pattern", metavar="REGEX", help="Only units whose whole serial matches.")
@which_options
@path_option("--limits", help="Limits file (YAML): the tolerance is the width between the limits of QUANTITY.")
@shelf_options
@answers
def fleet_gauge(quantity: str, out: Path, where: str | None, **options: Any) -> commands.Result:
    """Gauge R&R of QUANTITY, from units that several stations measured, each at least twice somewhere.

    Standard deviations of repetitions, stations and units by crossed analysis of variance and by REML; exit code 1 if
    the first two take more than 30 % (AIAG).
    """
    return commands.gauge(quantity, out, where, _selection(options), **options)


@fleet.command("refit")
@model_argument
@which_options
@path_option("--moments", help="Moments file. Default: that of the registry's runs.")
@path_option("--records", help="Write the records here. Default: beside the moments.")
@engine_options
@shelf_options
@answers
def fleet_refit(
    model: str, moments: Path | None, records: Path | None, out: Path, where: str | None, **work: Any
) -> commands.Result:
    """Refit every unit from the moments of its newest run of the profile; a failure does not stop the others."""
    return commands.refit(model, out, where, moments, records, commands.RefitOptions(_selection(work), **work))


@fleet.command("diagnose")
@model_argument
@which_options
@click.option("--again", is_flag=True, help="Also units whose run has a diagnosis of this model already.")
@engine_options
@shelf_options
@answers
def fleet_diagnose(model: str, out: Path, where: str | None, again: bool, **work: Any) -> commands.Result:
    """Find what the model of every unit lacks: a table of effects and lots, and what a lot has in common.

    Takes the newest run of each unit, and a diagnosis of the same model that its folder has. The others are made now
    and kept in the folders; an interrupted command goes on where it was.
    """
    return commands.diagnose_units(model, out, where, commands.RefitOptions(_selection(work), **work), again=again)


@click.group()
def lot() -> None:
    """One calibration for a lot of units."""


@lot.command("calibrate")
@click.argument("name", metavar="LOT")
@runs_argument
@model_argument
@effect_option
@out_option
@answers
def lot_calibrate(name: str, runs: tuple[Path, ...], model: str, out: Path) -> commands.Result:
    """Fit one model to runs of all units of LOT, and tell what each unit loses by it.

    The calibration stands in a run folder of LOT; `bench export` and `bench flash --run` deliver it.
    """
    return commands.calibrate_lot(runs, name, model, out)


@lot.command("check")
@path_argument("folder", metavar="LOT_FOLDER")
@runs_argument
@answers
def lot_check(folder: Path, runs: tuple[Path, ...]) -> commands.Result:
    """Tell whether the unit of each RUN is like the lot; exit code 1 where one is not."""
    return commands.check_lot(folder, runs)


@lot.command("complete")
@path_argument("folder", metavar="LOT_FOLDER")
@click.argument("run", type=RUN, metavar="RUN")
@out_option
@answers
def lot_complete(folder: Path, run: Path, out: Path) -> commands.Result:
    """Calibrate a unit whose RUN ended early: its rows, and the lot as the prior for what it did not run.

    The calibration stands in a run folder of the unit; `bench export` and `bench flash --run` deliver it.
    """
    return commands.complete_unit(folder, run, out)


@lot.command("plan")
@path_argument("folder", metavar="LOT_FOLDER")
@click.option(
    "--target",
    "target_dph",
    type=click.FloatRange(0.0, 1e6, min_open=True),
    required=True,
    metavar="DEG/H",
    help="Largest error over the lot's whole run [deg/h RMS], upper end of the 95 % interval.",
)
@path_option("--profile", help="Write the profile here. Default: short_<lot>.yaml.")
@path_option(
    "--station", help="Station file: try rates up to those of its chamber. Default: the rates of the lot's runs."
)
@answers
def lot_plan(folder: Path, target_dph: float, profile: Path | None, station: Path | None) -> commands.Result:
    """Write the shortest profile that calibrates a further unit of the lot well enough.

    Turning points, rates and soaks are chosen by the error of simulated runs of the lot's units by the profile. Check
    it with `bench check`, run it, and calibrate the unit with `bench lot complete`.
    """
    return commands.plan_lot(folder, target_dph, profile, station)


@lot.command("audits")
@path_argument("folder", metavar="LOT_FOLDER")
@out_option
@answers
def lot_audits(folder: Path, out: Path) -> commands.Result:
    """Tell what runs of the lot that ended early saved, and whether the audits bear their stated errors out."""
    return commands.audits(folder, out)
