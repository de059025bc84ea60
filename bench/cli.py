"""The command line: parse, call, print. Heavy imports live inside the commands, so that `--help` is quick.

Exit codes: 0 done and within limits; 1 done, outside limits; 2 bad input; 3 aborted by operator or guard (safe state
reached); 4 equipment failed. Every command that answers takes `--json`: one object on stdout, all else on stderr.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from datetime import datetime
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench import __version__
from bench.errors import BenchError
from drivers.errors import ConfigError, DriverError, IdentityError, LimitError

if TYPE_CHECKING:
    from bench.workflow.answer import Answer

json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, nothing else.")
station_option = click.option(
    "--station",
    type=click.Path(path_type=Path),
    help="Station file (YAML); default: the embedded simulator.",
)
model_option = click.option(
    "--model", "models", multiple=True, help="Model file or name; may be repeated. Default: the three of the papers."
)
model_argument = click.option("--model", required=True, help="Model file or name.")
live_argument = click.argument("run_folder", metavar="[RUN]", required=False, type=click.Path(path_type=Path))
runs_argument = click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
check_option = click.option(
    "--check", "check_runs", multiple=True, type=click.Path(path_type=Path), help="Held-out run; repeatable."
)
static_option = click.option(
    "--static", type=click.Path(path_type=Path), help="Isothermal run of the same unit: tells the noise."
)
effect_option = click.option("--effect", "own_effects", multiple=True, help="Effect of your own: file.py:Class.")
limits_option = click.option("--limits", type=click.Path(path_type=Path), help="Limits file (YAML): its verdict too.")
out_option = click.option(
    "--out", type=click.Path(path_type=Path), default=Path("reports"), show_default=True, help="Where run folders go."
)

registry_option = click.option(
    "--registry", "where", envvar="BENCH_REGISTRY", help="Registry: file, or postgresql://… [default: in --out]"
)


def _registers(begin: bool) -> Callable[[Callable[..., Answer]], Callable[..., Answer]]:
    """Register the runs that a command's answer names; `begin` a registry where there is none."""

    def decorate(command: Callable[..., Answer]) -> Callable[..., Answer]:
        @wraps(command)
        def wrapped(*args: Any, where: str | None = None, **kwargs: Any) -> Answer:
            from bench.workflow.registering import registered

            return registered(command(*args, **kwargs), where, begin)

        return wrapped

    return decorate


def _answer(command: Callable[..., Answer]) -> Callable[..., None]:
    """Print the answer as text or JSON; turn the errors of bench and drivers into one line and an exit code.

    Anything else is our bug and shows its traceback.
    """

    @wraps(command)
    def wrapped(*args: Any, as_json: bool = False, own_effects: tuple[str, ...] = (), **kwargs: Any) -> None:
        code: int
        try:
            if own_effects:
                from bench.effects.registry import load_effect

                for spec in own_effects:
                    load_effect(spec)
            answer = command(*args, **kwargs)
            click.echo(json.dumps(answer.content, allow_nan=False) if as_json else answer.text)
            code = answer.exit_code
        except BenchError as error:
            print(f"bench: {error}", file=sys.stderr)
            code = error.exit_code
        except DriverError as error:
            print(f"bench: {error}", file=sys.stderr)
            code = 2 if isinstance(error, (ConfigError, LimitError, IdentityError)) else 4
        sys.exit(code)

    return wrapped


def _address(context: click.Context, parameter: click.Parameter, text: str) -> int:
    """An address of 32 bits, decimal or 0x..."""
    try:
        address = int(text, 0)
    except ValueError:
        address = -1
    if not 0 <= address < 1 << 32:
        raise click.BadParameter(f"{text!r} is not an address from 0 to 0xFFFFFFFF", context, parameter)
    return address


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="bench")
def main() -> None:
    """Thermal test bench for gyroscopes: run a chamber, capture without loss, fit, diagnose, calibrate.

    Start with `bench run profiles/ramp_-40_85.yaml`: it needs no equipment.
    """


@main.command()
@click.argument("profile", type=click.Path(path_type=Path))
@station_option
@click.option("--unit", "serials", multiple=True, help="Serial number; may be repeated. Default: all of the station.")
@model_option
@limits_option
@click.option("--production", is_flag=True, help="Refuse to start without equipment whose calibrations are valid.")
@click.option("--equipment", type=click.Path(path_type=Path), help="Reference equipment with its due dates (YAML).")
@effect_option
@out_option
@click.option("--quiet", is_flag=True, help="No progress display.")
@registry_option
@json_option
@_answer
@_registers(begin=True)
def run(profile: Path, station: Path | None, out: Path, quiet: bool, **wishes: Any) -> Answer:
    """Run PROFILE: drive the chamber, capture the units, fit the models, write the reports."""
    from bench.workflow import acquisition

    return acquisition.run(profile, station, acquisition.Wishes(**wishes), out, quiet)


@main.command()
@click.argument("profile", type=click.Path(path_type=Path))
@station_option
@json_option
@_answer
def check(profile: Path, station: Path | None) -> Answer:
    """Say everything about PROFILE that can be known before anything moves."""
    from bench.workflow import acquisition

    return acquisition.check(profile, station)


@main.command()
@runs_argument
@model_option
@effect_option
@check_option
@static_option
@json_option
@_answer
def compare(
    runs: tuple[Path, ...], models: tuple[str, ...], check_runs: tuple[Path, ...], static: Path | None
) -> Answer:
    """Model against measurement: in-sample and held-out error beside the noise floor, models side by side."""
    from bench.workflow import analysis

    return analysis.compare(runs, models, check_runs, static)


@main.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@model_option
@effect_option
@check_option
@static_option
@limits_option
@registry_option
@json_option
@_answer
@_registers(begin=False)
def report(
    run_folder: Path, models: tuple[str, ...], check_runs: tuple[Path, ...], static: Path | None, limits: Path | None
) -> Answer:
    """Analyse RUN again and write its report; a killed run is recovered from its journals first.

    Its diagnosis is made anew with the --static and --check runs given, and saved as diagnosis.json; one that was made
    with more runs is kept as diagnosis-before.json, and the report says so.
    """
    from bench.workflow import analysis

    return analysis.report(run_folder, models, check_runs, static, limits)


@main.command()
@runs_argument
@click.option("--model", "models", multiple=True, help="Model of its analysis that the run does not keep; repeatable.")
@click.option("--with", "others", multiple=True, type=click.Path(path_type=Path), help="Further run of its analysis.")
@effect_option
@json_option
@_answer
def replay(runs: tuple[Path, ...], models: tuple[str, ...], others: tuple[Path, ...]) -> Answer:
    """Make the numbers of each RUN again from its raw frames; exit code 1 where a bit differs, and what it is."""
    from bench.workflow import comparing

    return comparing.replay(runs, models, others)


@main.command()
@click.argument("a", metavar="A", type=click.Path(path_type=Path))
@click.argument("b", metavar="B", type=click.Path(path_type=Path))
@effect_option
@json_option
@_answer
def diff(a: Path, b: Path) -> Answer:
    """What differs between the runs A and B, of one unit or of two: settings, coefficients, residuals, curves."""
    from bench.workflow import comparing

    return comparing.diff(a, b)


@main.command()
@live_argument
@out_option
@json_option
@_answer
def status(run_folder: Path | None, out: Path) -> Answer:
    """What a live RUN does just now; without RUN: all of them."""
    from bench.workflow import live

    return live.status(run_folder, out)


@main.command()
@live_argument
@out_option
@json_option
@_answer
def hold(run_folder: Path | None, out: Path) -> Answer:
    """Hold a live RUN at once, where its chamber is; without RUN: the only one."""
    from bench.workflow import live

    return live.act("hold", run_folder, out)


@main.command()
@live_argument
@out_option
@json_option
@_answer
def pause(run_folder: Path | None, out: Path) -> Answer:
    """Hold a live RUN after its present segment; without RUN: the only one."""
    from bench.workflow import live

    return live.act("pause", run_folder, out)


@main.command()
@live_argument
@click.option("--station", type=click.Path(path_type=Path), help="Station file, where the one of the run is outdated.")
@effect_option
@out_option
@click.option("--quiet", is_flag=True, help="No progress display.")
@json_option
@_answer
def resume(run_folder: Path | None, station: Path | None, out: Path, quiet: bool) -> Answer:
    """Go on: with a live RUN that holds, or with one whose bench was killed, from where its journals end."""
    from bench.workflow import live

    return live.resume(run_folder, station, out, quiet)


@main.command()
@live_argument
@out_option
@json_option
@_answer
def abort(run_folder: Path | None, out: Path) -> Answer:
    """End a live RUN and say what the safe state reached; asks nothing. Without RUN: the only one."""
    from bench.workflow import live

    return live.abort(run_folder, out)


@main.command("import")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--columns", type=click.Path(path_type=Path), help="Column map (YAML): which column, which unit.")
@click.option("--unit", "serial", default="unknown", show_default=True, help="Serial number of the unit.")
@click.option("--dbc", type=click.Path(path_type=Path), help="Layout of a CAN log (BLF, ASC).")
@click.option("--preview", is_flag=True, help="Only say what was understood; write nothing.")
@out_option
@registry_option
@json_option
@_answer
@_registers(begin=True)
def import_(file: Path, serial: str, out: Path, columns: Path | None, dbc: Path | None, preview: bool) -> Answer:
    """Make a run folder of somebody else's FILE: CSV, Parquet, MF4, BLF or ASC."""
    from bench.workflow import analysis

    return analysis.import_table(file, columns, serial, dbc, None if preview else out)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@json_option
@_answer
def init(folder: Path) -> Answer:
    """Copy the shipped profiles, stations and models to FOLDER/profiles, as your own."""
    from bench.workflow import acquisition

    return acquisition.init(folder)


@main.command()
@station_option
@click.option("--modbus-port", type=click.IntRange(0, 65535), default=0, help="Port of the chamber; 0: any free one.")
@click.option("--can-port", type=click.IntRange(0, 65535), default=0, help="Port of the CAN bus; 0: any free one.")
@click.option("--speed", type=click.FloatRange(0.01, 1000.0), default=1.0, show_default=True, help="Times wall time.")
@click.option("--write-station", type=click.Path(path_type=Path), help="Write the station file that drives it.")
@json_option
@_answer
def sim(station: Path | None, modbus_port: int, can_port: int, speed: float, write_station: Path | None) -> Answer:
    """Serve the simulated station on 127.0.0.1 until Ctrl-C: Modbus TCP, and CAN as python-can's `loopcan`."""
    from bench.workflow import acquisition

    return acquisition.sim(station, (modbus_port, can_port), speed, write_station)


@main.command()
@click.argument("station", required=False, type=click.Path(path_type=Path))
@click.option("--listen", "listen_s", type=click.FloatRange(0.1, 600.0), default=2.0, help="Seconds at each bus.")
@click.option("--contract", is_flag=True, help="Try the station's register map on a simulated controller instead.")
@json_option
@_answer
def doctor(station: Path | None, listen_s: float, contract: bool) -> Answer:
    """Ask the equipment of STATION what it is, read-only, and say what agrees with the file and what does not."""
    from bench.workflow import examination

    return examination.contract(station) if contract else examination.doctor(station, listen_s)


@main.command()
@runs_argument
@model_argument
@check_option
@static_option
@click.option("--plan", type=click.Path(path_type=Path), help="Where to write the profile that would separate a tie.")
@effect_option
@json_option
@_answer
def diagnose(
    runs: tuple[Path, ...],
    check_runs: tuple[Path, ...],
    static: Path | None,
    model: str,
    plan: Path | None,
) -> Answer:
    """Where the model fails, which physical effect is missing, and which experiment would tell."""
    from bench.workflow import diagnosis

    return diagnosis.diagnose(runs, check_runs, static, model, plan)


@main.command()
@click.argument("effect")
@model_argument
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The new model file.")
@effect_option
@json_option
@_answer
def add(effect: str, model: str, out: Path) -> Answer:
    """Write a model with one more EFFECT; then `bench compare` shows whether the error falls."""
    from bench.workflow import diagnosis

    return diagnosis.add(effect, model, out)


@main.command()
@click.argument("action", type=click.Choice(["list", "show"]), default="list")
@click.argument("name", required=False)
@effect_option
@json_option
@_answer
def effects(action: str, name: str | None) -> Answer:
    """The catalogue of physical effects; `show NAME` explains and draws one."""
    from bench.workflow import diagnosis

    if (action == "show") != (name is not None):
        raise click.UsageError("`bench effects` lists all, `bench effects show NAME` explains one")
    return diagnosis.effects() if name is None else diagnosis.show_effect(name)


@main.command()
@runs_argument
@model_argument
@check_option
@static_option
@click.option("--out", type=click.Path(path_type=Path), help="Write the model that the walk ends with.")
@effect_option
@json_option
@_answer
def improve(
    runs: tuple[Path, ...],
    check_runs: tuple[Path, ...],
    static: Path | None,
    model: str,
    out: Path | None,
) -> Answer:
    """The whole walk unattended: diagnose, add, prove on unseen data, until nothing more pays."""
    from bench.workflow import diagnosis

    return diagnosis.improve(runs, check_runs, static, model, out)


@main.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option("--format", "format_", required=True, help="json, csv, c, hex, srec, eeprom or a2l.")
@click.option("--model", help="Model to fit instead of the calibration that the run's report chose.")
@click.option("--form", help="float32, fixed, split or split_fixed; default: the one with the least error.")
@click.option("--serial", type=click.IntRange(0, 2**32 - 1), help="Default: the digits of the unit's serial number.")
@click.option("--sample-hz", type=click.FloatRange(1e-3, 1e5), default=500.0, show_default=True, help="The unit's own.")
@click.option("--name", default="calibration", show_default=True, help="Name of the files, and of the C functions.")
@click.option("--address", default="0", callback=_address, help="Of the image in hex, srec and a2l, such as 0x8000.")
@click.option("--force", is_flag=True, help="Deliver a calibration that must not be trusted; the answer says why.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the files; default: export in the run folder.")
@json_option
@_answer
def export(run_folder: Path, format_: str, out: Path | None, **wishes: Any) -> Answer:
    """The calibration of RUN for its unit: C code, EEPROM image, hex files; worst error of each embedded form."""
    from bench.export.delivering import Wishes
    from bench.workflow import delivering

    return delivering.export(run_folder, format_, Wishes(**wishes), out)


@main.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option("--verification", type=click.Path(path_type=Path), help="Independent run of the calibrated unit.")
@limits_option
@click.option("--equipment", type=click.Path(path_type=Path), help="Reference equipment with its due dates (YAML).")
@click.option("--laboratory", type=click.Path(path_type=Path), help="Laboratory, customer, who signs (YAML).")
@click.option("--issued", help="Day of issue, YYYY-MM-DD; default: today (UTC).")
@click.option("--out", type=click.Path(path_type=Path), help="The PDF; default: certificate.pdf in the run folder.")
@registry_option
@json_option
@_answer
@_registers(begin=False)
def certificate(run_folder: Path, out: Path | None, **wishes: Any) -> Answer:
    """Certificate of RUN as PDF, the same facts as JSON attached and beside it; refused where nothing is proven."""
    from bench.workflow import certifying

    return certifying.certificate(run_folder, certifying.Wishes(**wishes), out)


@main.command()
@click.argument("unit")
@click.option("--run", type=click.Path(path_type=Path), help="Take this run; default: the newest of the unit.")
@click.option("--image", type=click.Path(path_type=Path), help="Write this image (docs/eeprom.md) as it is.")
@click.option("--form", help="float32, fixed, split or split_fixed; default: the one with the least error.")
@click.option("--model", help="Model to fit instead of the calibration that the run's report chose.")
@click.option("--older", is_flag=True, help="Write a calibration that is older than the one in the unit.")
@station_option
@out_option
@click.option("--quiet", is_flag=True, help="No progress display.")
@json_option
@_answer
def flash(unit: str, station: Path | None, out: Path, quiet: bool, **wishes: Any) -> Answer:
    """Write a calibration into UNIT: other bank, read back, CRC, switch, reset, read again; the old one stays whole."""
    from bench.workflow import flashing

    return flashing.flash(unit, station, flashing.Wishes(**wishes), out, quiet)


@main.command()
@click.argument("profile", type=click.Path(path_type=Path))
@click.option("--unit", "serial", required=True, help="Serial number.")
@station_option
@limits_option
@out_option
@click.option("--quiet", is_flag=True, help="No progress display.")
@json_option
@_answer
def verify(profile: Path, serial: str, station: Path | None, limits: Path | None, out: Path, quiet: bool) -> Answer:
    """Run PROFILE with the unit's own correction on, and judge what it leaves; nothing is fitted."""
    from bench.workflow import flashing

    return flashing.verify(profile, serial, station, limits, out, quiet)


@main.command()
@click.option("--unit", "serial", required=True, help="Serial number of the unit.")
@click.option("--plan", "plan", required=True, type=click.Path(path_type=Path), help="Plan file (YAML).")
@station_option
@click.option("--junit", type=click.Path(path_type=Path), help="Write JUnit XML here: steps and limits as test cases.")
@click.option("--release", metavar="REASON", help="Go on with a job that is held; who decided, and why.")
@click.option("--new", "anew", is_flag=True, help="Begin a new job where one by this plan exists.")
@out_option
@click.option("--quiet", is_flag=True, help="No progress display.")
@registry_option
@json_option
@_answer
@_registers(begin=True)
def calibrate(
    serial: str, plan: Path, station: Path | None, out: Path, quiet: bool, **wishes: Any
) -> Answer:
    """From the shelf to a certificate: check, run, fit, diagnose, flash, verify, certificate; goes on where it was."""
    from bench.production import command
    from bench.production.order import Order

    return command.run(Order.load(plan, station, serial, out, quiet), **wishes)


@main.command()
@click.option("--seed", type=click.IntRange(0), help="Same seed, same unit; default: a random one.")
@click.option("--effects", "count", type=click.IntRange(1), default=1, show_default=True, help="How many are hidden.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("mystery"), show_default=True, help="Its folder.")
@json_option
@_answer
def mystery(seed: int | None, count: int, out: Path) -> Answer:
    """Record a simulated unit with hidden effects, a check run and an isothermal run, and tell nothing."""
    from bench.workflow import diagnosis

    return diagnosis.mystery(seed, count, out)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path))
@model_argument
@effect_option
@json_option
@_answer
def reveal(folder: Path, model: str) -> Answer:
    """Open the envelope of a mystery in FOLDER and score your model against the truth."""
    from bench.workflow import diagnosis

    return diagnosis.reveal(folder, model)


@main.group()
def registry() -> None:
    """What units, runs, calibrations and equipment there are; run folders stay the truth."""


@registry.command("list")
@click.option("--unit", help="Only runs of this unit.")
@click.option("--most", type=click.IntRange(1), default=50, show_default=True, help="Newest runs to list.")
@out_option
@registry_option
@json_option
@_answer
def registry_list(unit: str | None, most: int, out: Path, where: str | None) -> Answer:
    """The runs, newest first, with the verdicts of their calibrations."""
    from bench.workflow import registering

    return registering.listing(out, where, unit, most)


@registry.command("show")
@click.argument("name", metavar="UNIT|RUN")
@out_option
@registry_option
@json_option
@_answer
def registry_show(name: str, out: Path, where: str | None) -> Answer:
    """All that is known of a unit or a run."""
    from bench.workflow import registering

    return registering.show(out, where, name)


@registry.command("rebuild")
@click.option("--check", "only_compare", is_flag=True, help="Change nothing; exit code 1 where something differs.")
@out_option
@registry_option
@json_option
@_answer
def registry_rebuild(only_compare: bool, out: Path, where: str | None) -> Answer:
    """Make the rows again from the run folders, say what differed, and prove that they are equal."""
    from bench.workflow import registering

    return registering.rebuild(out, where, only_compare)


@registry.command("lot")
@click.argument("lot")
@click.argument("serials", nargs=-1, required=True)
@out_option
@registry_option
@json_option
@_answer
def registry_lot(lot: str, serials: tuple[str, ...], out: Path, where: str | None) -> Answer:
    """Say that the units SERIALS are of LOT."""
    from bench.workflow import registering

    entry = {"kind": "lot", "lot": lot, "units": list(serials)}
    return registering.tell(out, where, entry, f"{len(serials)} units are of lot {lot}")


@registry.command("operator")
@click.argument("name")
@out_option
@registry_option
@json_option
@_answer
def registry_operator(name: str, out: Path, where: str | None) -> Answer:
    """Add an operator."""
    from bench.workflow import registering

    return registering.tell(out, where, {"kind": "operator", "name": name}, f"operator {name}")


@registry.group("equipment")
def registry_equipment() -> None:
    """Chambers, sensors, rate tables, time bases, and until when their own calibrations hold."""


@registry_equipment.command("add")
@click.argument("name")
@click.argument("serial")
@click.option("--kind", required=True, help="What it is: chamber, sensor, rate table, time base.")
@click.option("--calibrated", type=click.DateTime(["%Y-%m-%d"]), help="Day of its last calibration.")
@click.option("--due", type=click.DateTime(["%Y-%m-%d"]), help="Last day on which that calibration is valid.")
@out_option
@registry_option
@json_option
@_answer
def registry_equipment_add(name: str, serial: str, out: Path, where: str | None, **given: Any) -> Answer:
    """Add a piece of equipment, or its new calibration."""
    from bench.workflow import registering

    return registering.add_equipment(out, where, name, serial, **given)


@registry_equipment.command("list")
@click.option("--on", type=click.DateTime(["%Y-%m-%d"]), help="Day to judge by. Default: today.")
@out_option
@registry_option
@json_option
@_answer
def registry_equipment_list(on: datetime | None, out: Path, where: str | None) -> Answer:
    """The equipment, what is due first on top; exit code 1 where a calibration is overdue."""
    from bench.workflow import registering

    return registering.equipment(out, where, (on or datetime.now()).date())


@main.group(invoke_without_command=True)
@click.option("--unit-filter", "pattern", metavar="REGEX", help="Only units whose whole serial matches.")
@click.option("--limits", type=click.Path(path_type=Path), help="Limits file (YAML): yield and Cpk are against it.")
@click.option("--html", type=click.Path(path_type=Path), help="Write the page here.")
@click.option("--csv", type=click.Path(path_type=Path), help="Write one line a unit and quantity here.")
@out_option
@registry_option
@json_option
@click.pass_context
def fleet(context: click.Context, /, **wishes: Any) -> None:
    """Many units: first-pass yield, Cpk, control charts, drift of stations and lots, units unlike their lot."""
    if context.invoked_subcommand is None:
        _fleet(**wishes)


@_answer
def _fleet(pattern: str | None, limits: Path | None, out: Path, where: str | None, **files: Path | None) -> Answer:
    from bench.workflow import fleet as work

    return work.fleet(out, where, pattern, limits, **files)


@fleet.command("refit")
@model_argument
@click.option("--moments", type=click.Path(path_type=Path), help="Moments file. Default: of the registry's runs.")
@click.option("--records", type=click.Path(path_type=Path), help="Where the records go. Default: beside the moments.")
@click.option("--engine", type=click.Choice(["auto", "serial", "pool", "dask"]), default="auto", show_default=True)
@click.option("--workers", type=click.IntRange(1), help="Processes. Default: one a processor.")
@click.option("--scheduler", metavar="tcp://…", help="A running Dask cluster. Default: a local one.")
@out_option
@registry_option
@json_option
@_answer
def fleet_refit(
    model: str, moments: Path | None, records: Path | None, out: Path, where: str | None, **work: Any
) -> Answer:
    """Fit every stored unit anew, from small moments of its newest run; one that fails does not stop the rest."""
    from bench.workflow import refitting

    return refitting.refit(model, out, where, moments, records, refitting.Work(**work))
