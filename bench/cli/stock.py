"""Commands on many units: registry and fleet."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.cli.options import answer, answers, archive_options, json_option, model_argument, path_option

if TYPE_CHECKING:
    from bench.commands import Result


@click.group()
def registry() -> None:
    """What units, runs, calibrations and equipment there are; run folders stay the truth."""


@registry.command("list")
@click.option("--unit", help="Only runs of this unit.")
@click.option("--most", type=click.IntRange(1), default=50, show_default=True, help="Newest runs to list.")
@archive_options
@answers
def registry_list(unit: str | None, most: int, out: Path, where: str | None) -> Result:
    """The runs, newest first, with the verdicts of their calibrations."""
    from bench import commands

    return commands.registry_list(out, where, unit, most)


@registry.command("show")
@click.argument("name", metavar="UNIT|RUN")
@archive_options
@answers
def registry_show(name: str, out: Path, where: str | None) -> Result:
    """All that is known of a unit or a run."""
    from bench import commands

    return commands.registry_show(out, where, name)


@registry.command("rebuild")
@click.option("--check", "only_compare", is_flag=True, help="Change nothing; exit code 1 where something differs.")
@archive_options
@answers
def registry_rebuild(only_compare: bool, out: Path, where: str | None) -> Result:
    """Make the rows again from the run folders, say what differed, and prove that they are equal."""
    from bench import commands

    return commands.registry_rebuild(out, where, only_compare)


@registry.command("lot")
@click.argument("lot")
@click.argument("serials", nargs=-1, required=True)
@archive_options
@answers
def registry_lot(lot: str, serials: tuple[str, ...], out: Path, where: str | None) -> Result:
    """Say that the units SERIALS are of LOT."""
    from bench import commands

    entry = {"kind": "lot", "lot": lot, "units": list(serials)}
    return commands.registry_tell(out, where, entry)


@registry.command("operator")
@click.argument("name")
@archive_options
@answers
def registry_operator(name: str, out: Path, where: str | None) -> Result:
    """Add an operator."""
    from bench import commands

    return commands.registry_tell(out, where, {"kind": "operator", "name": name})


@registry.group("equipment")
def registry_equipment() -> None:
    """Chambers, sensors, rate tables, time bases, and until when their own calibrations hold."""


@registry_equipment.command("add")
@click.argument("name")
@click.argument("serial")
@click.option("--kind", required=True, help="What it is: chamber, sensor, rate table, time base.")
@click.option("--calibrated", type=click.DateTime(["%Y-%m-%d"]), help="Day of its last calibration.")
@click.option("--due", type=click.DateTime(["%Y-%m-%d"]), help="Last day on which that calibration is valid.")
@archive_options
@answers
def registry_equipment_add(name: str, serial: str, out: Path, where: str | None, **given: Any) -> Result:
    """Add a piece of equipment, or its new calibration."""
    from bench import commands

    return commands.add_equipment(out, where, name, serial, **given)


@registry_equipment.command("list")
@click.option("--on", type=click.DateTime(["%Y-%m-%d"]), help="Day to judge by. Default: today.")
@archive_options
@answers
def registry_equipment_list(on: datetime | None, out: Path, where: str | None) -> Result:
    """The equipment, what is due first on top; exit code 1 where a calibration is overdue."""
    from bench import commands

    return commands.registry_equipment(out, where, (on or datetime.now()).date())


@click.group(invoke_without_command=True)
@click.option("--unit-filter", "pattern", metavar="REGEX", help="Only units whose whole serial matches.")
@path_option("--limits", help="Limits file (YAML): yield and Cpk are against it.")
@path_option("--html", help="Write the page here.")
@path_option("--csv", help="Write one line a unit and quantity here.")
@archive_options
@json_option
@click.pass_context
def fleet(context: click.Context, /, out: Path, as_json: bool, **options: Any) -> None:
    """Many units: first-pass yield, Cpk, control charts, drift of stations and lots, units unlike their lot."""
    if context.invoked_subcommand is None:
        from bench import commands

        answer(lambda: commands.fleet(out, **options), as_json)


@fleet.command("refit")
@model_argument
@path_option("--moments", help="Moments file. Default: of the registry's runs.")
@path_option("--records", help="Where the records go. Default: beside the moments.")
@click.option(
    "--engine",
    type=click.Choice(["auto", "serial", "pool", "dask"]),
    default="auto",
    show_default=True,
    help="On this computer in one process (serial) or several (pool), or on a Dask cluster (dask).",
)
@click.option("--workers", type=click.IntRange(1), help="Processes. Default: one a processor.")
@click.option("--scheduler", metavar="tcp://…", help="A running Dask cluster. Default of dask: a local one.")
@archive_options
@answers
def fleet_refit(
    model: str, moments: Path | None, records: Path | None, out: Path, where: str | None, **work: Any
) -> Result:
    """Fit every stored unit anew, from small moments of its newest run; one that fails does not stop the rest."""
    from bench import commands

    return commands.refit(model, out, where, moments, records, commands.RefitOptions(**work))
