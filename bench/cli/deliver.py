"""Commands that take a calibration to its unit: export, flash, verify, certificate, calibrate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from bench import commands, deliver
from bench.cli import completion
from bench.cli.options import (
    UNIT,
    answers,
    limits_option,
    out_option,
    output_option,
    path_argument,
    path_option,
    quiet_option,
    registers,
    run_argument,
    station_option,
)


def _address(context: click.Context, parameter: click.Parameter, text: str) -> int:
    """An address of 32 bits, decimal or 0x..."""
    try:
        address = int(text, 0)
    except ValueError:
        address = -1
    if not 0 <= address < 1 << 32:
        raise click.BadParameter(f"{text!r} is not an address from 0 to 0xFFFFFFFF", context, parameter)
    return address


@click.command()
@run_argument
@click.option(
    "--format",
    "format_",
    required=True,
    help="json, csv, c, hex, srec, eeprom or a2l; mf4 (samples), kalibr; of an inertial unit px4 and ardupilot.",
)
@click.option("--model", help="Model to fit instead of the calibration that the run's report chose.")
@click.option("--form", help="float32, fixed, split or split_fixed; default: the one with the least error.")
@click.option("--serial", type=click.IntRange(0, 2**32 - 1), help="Default: the digits of the unit's serial number.")
@click.option("--sample-hz", type=click.FloatRange(1e-3, 1e5), default=500.0, show_default=True, help="Of the unit.")
@click.option("--name", default="calibration", show_default=True, help="Name of the files, and of the C functions.")
@click.option(
    "--address", default="0", callback=_address, help="Address of the image in hex, srec and a2l, such as 0x8000."
)
@click.option("--force", is_flag=True, help="Deliver an untrustworthy calibration; the result states the reasons.")
@output_option
@path_option("--out", help="Folder of the files; default: export in the run folder.")
@answers
def export(run_folder: Path, format_: str, output: str | None, out: Path | None, **options: Any) -> commands.Result:
    """Write the calibration of RUN for its unit: C code, EEPROM image, hex files; worst error of each embedded form.

    RUN may be the calibration of an inertial unit (folder or imu.json of `bench imu --out`): all its axes in one image.
    """
    return commands.export(run_folder, format_, deliver.ExportOptions(**options), out, output)


@click.command()
@path_argument("run_folder", metavar="[RUN]", required=False)
@path_option(
    "--verification", "verifications", multiple=True,
    help="Independent run of the calibrated unit; more of them add turn-ons to the uncertainty.",
)  # fmt: skip
@limits_option
@path_option("--equipment", help="Reference equipment with due dates (YAML); default: that of the run folder.")
@path_option("--laboratory", help="Laboratory, customer, signatory (YAML); default: that of the run folder.")
@click.option("--issued", help="Day of issue, YYYY-MM-DD; default: today (UTC).")
@click.option("--draft", is_flag=True, help="Print it although something is missing, which stands across each page.")
@path_option("--sign-key", help="Key that signs (PEM); default: laboratory.key in the folder of the keys.")
@path_option("--sign-certificate", help="Certificate of that key (PEM); default: laboratory.pem there.")
@path_option("--out", help="The PDF; default: certificate.pdf, or draft.pdf, in the run folder.")
@click.option("--amends", metavar="NUMBER", help="Certificate that this one replaces; it refers to it.")
@click.option("--withdraw", metavar="NUMBER", help="Instead: a certificate of --archive is no longer in force.")
@click.option("--reason", help="Why it is amended or withdrawn.")
@path_option(
    "--archive", default=Path("reports"), show_default=True, help="With --withdraw and --verify: the run folders."
)
@output_option
@path_option("--verify", help="Instead: check the signatures of this PDF or XML; exit code 1 if it was altered.")
@path_option("--trust", multiple=True, help="With --verify: certificate of a laboratory or its authority (PEM).")
@answers
@registers(begin=False, pass_on=True)
def certificate(run_folder: Path | None, out: Path | None, **options: Any) -> commands.Result:
    """Write the certificate of RUN as signed PDF and XML; refused without sufficient evidence. Or verify one.

    RUN may be the folder of an inertial unit's calibration (`bench imu --out`).
    """
    names = ("verify", "trust", "withdraw", "archive", "registry")
    verify, trust, withdraw, archive, where = (options.pop(name) for name in names)
    output = options.pop("output")
    if verify is not None:
        return commands.verify_certificate(verify, trust, archive)
    if (options["amends"] or withdraw) and not (options["reason"] or "").strip():
        raise click.UsageError("say why it is amended or withdrawn with --reason TEXT")
    if withdraw is not None:
        return commands.withdraw_certificate(withdraw, options["reason"], archive, where)
    if run_folder is None:
        raise click.UsageError("name the RUN, or a certificate with --verify FILE or --withdraw NUMBER")
    options["verifications"] = commands.of_outputs(options["verifications"], output)
    chosen = commands.CertificateOptions(**options)
    if output is None and commands.is_imu(run_folder):
        return commands.imu_certificate(run_folder, chosen, out)
    return commands.certificate(commands.of_one(run_folder, output), chosen, out)


@click.command()
@click.argument("unit", shell_complete=completion.units)
@path_option("--run", help="Use this run; default: the newest of the unit.")
@path_option("--image", help="Write this image (docs/eeprom.md) unchanged.")
@click.option("--form", help="float32, fixed, split or split_fixed; default: the one with the least error.")
@click.option("--model", help="Model to fit instead of the calibration that the run's report chose.")
@path_option("--check", help="With a lot's calibration as --run: a run of UNIT, which shows that it is like the lot.")
@click.option("--older", is_flag=True, help="Write a calibration that is older than the one in the unit.")
@click.option(
    "--previous", is_flag=True,
    help="Instead: put the calibration that the unit's other bank holds back in force; nothing is written.",
)  # fmt: skip
@station_option
@out_option
@quiet_option
@answers
def flash(unit: str, station: Path | None, out: Path, quiet: bool, **options: Any) -> commands.Result:
    """Write a calibration to UNIT: other bank, read back, CRC, switch, reset, read again; the old one is kept."""
    return commands.flash(unit, station, commands.FlashOptions(**options), out, quiet)


@click.command()
@path_argument("profile")
@click.option("--unit", "serial", required=True, shell_complete=completion.units, help=UNIT)
@station_option
@limits_option
@out_option
@quiet_option
@answers
@registers(begin=True)
def verify(
    profile: Path, serial: str, station: Path | None, limits: Path | None, out: Path, quiet: bool
) -> commands.Result:
    """Run PROFILE with the unit's correction on, and judge the residual error; nothing is fitted."""
    return commands.verify(profile, serial, station, limits, out, quiet)


@click.command()
@click.option(
    "--unit", "serials", required=True, multiple=True, shell_complete=completion.units,
    help=f"{UNIT} Several: runs are made once for all.",
)  # fmt: skip
@path_option("--plan", "plan", required=True, help="Plan file (YAML).")
@station_option
@path_option("--junit", help="Write JUnit XML here: steps and limits as test cases.")
@click.option("--release", metavar="REASON", help="Continue a held job; who decided, and why.")
@click.option("--new", "anew", is_flag=True, help="Begin a new job even if one by this plan exists.")
@click.option("--operator", default="", help="Who works on it, for the record. Default: the user.")
@out_option
@quiet_option
@answers
@registers(begin=True)
def calibrate(
    serials: tuple[str, ...], plan: Path, station: Path | None, out: Path, quiet: bool, operator: str, **options: Any
) -> commands.Result:
    """Calibrate units: check, run, fit, diagnose, flash, verify, certificate; continues an interrupted job."""
    orders = commands.Order.load_all(plan, station, serials, out, quiet)
    return commands.calibrate_units([replace(order, operator=operator) for order in orders], **options)
