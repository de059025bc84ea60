"""Commands that need equipment, real or simulated: run, check, live runs, doctor, sim; and init."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from bench import acquisition, commands
from bench.cli import completion
from bench.cli.options import (
    UNIT,
    answers,
    effect_option,
    limits_option,
    live_options,
    model_option,
    out_option,
    path_argument,
    path_option,
    queue_option,
    quiet_option,
    registers,
    station_option,
)


@click.command()
@path_argument("profile")
@station_option
@click.option(
    "--unit",
    "serials",
    multiple=True,
    shell_complete=completion.units,
    help=f"{UNIT} May be repeated. Default: all of the station.",
)
@model_option
@limits_option
@click.option("--production", is_flag=True, help="Refuse to start without valid equipment.")
@path_option("--equipment", help="Equipment with due dates (YAML) [production: registry's]")
@path_option("--lot", help="Run folder of a calibrated lot: `until` in PROFILE may end the run early.")
@effect_option
@out_option
@quiet_option
@click.option("--operator", default="", help="Who starts it, for the record. Default: the user.")
@path_option("--junit", help="Write JUnit XML here: segments, verdict and limits as test cases.")
@answers
@registers(begin=True, pass_on=True)
def run(profile: Path, station: Path | None, out: Path, quiet: bool, **options: Any) -> commands.Result:
    """Run PROFILE: drive the chamber, capture the units, fit the models, write the reports."""
    if sys.stderr.isatty() and not quiet:  # at once: what follows takes a while to load
        click.echo(f"{profile}: checking, then opening the station", err=True)
    return commands.run_profile(profile, station, commands.RunOptions(**options), out, quiet)


@click.command()
@path_argument("profile")
@station_option
@path_option("--limits", help="Limits file (YAML) for the run: warns of a range that PROFILE does not reach.")
@answers
def check(profile: Path, station: Path | None, limits: Path | None) -> commands.Result:
    """Check PROFILE before anything moves: duration, segments, findings."""
    return commands.check(profile, station, limits)


@click.command()
@live_options
@answers
def status(run_folder: Path | None, out: Path, server: str | None) -> commands.Result:
    """Show the state of a live RUN; without RUN: of all live runs."""
    if server:
        return commands.server_status(commands.server_at(server), run_folder)
    return commands.status(run_folder, out)


@click.command()
@live_options
@answers
def hold(run_folder: Path | None, out: Path, server: str | None) -> commands.Result:
    """Hold a live RUN at once, at the current temperature; without RUN: the only one."""
    return _act("hold", run_folder, out, server)


@click.command()
@live_options
@answers
def pause(run_folder: Path | None, out: Path, server: str | None) -> commands.Result:
    """Hold a live RUN after its current segment; without RUN: the only one."""
    return _act("pause", run_folder, out, server)


def _act(action: str, run_folder: Path | None, out: Path, server: str | None) -> commands.Result:
    """Request an action of a live run, through a server if one is named."""
    if server:
        return commands.server_act(commands.server_at(server), action, run_folder)
    return commands.act_on_run(action, run_folder, out)


@click.command()
@live_options
@path_option("--station", help="Station file, if the one of the run is outdated.")
@effect_option
@quiet_option
@answers
@registers(begin=True)
def resume(
    run_folder: Path | None, station: Path | None, out: Path, server: str | None, quiet: bool
) -> commands.Result:
    """Continue a live RUN that holds, or a RUN whose bench was killed, from the end of its journals."""
    if server:
        return _act("resume", run_folder, out, server)
    return commands.resume(run_folder, station, out, quiet)


@click.command()
@live_options
@answers
def abort(run_folder: Path | None, out: Path, server: str | None) -> commands.Result:
    """End a live RUN and report the safe state; does not ask for confirmation. Without RUN: the only one."""
    if server:
        return commands.server_abort(commands.server_at(server), run_folder)
    return commands.abort(run_folder, out)


@click.group()
def queue() -> None:
    """What waits for its station at a `bench ui`: list it, change its order, take something out."""


@queue.command("list")
@queue_option
@answers
def queue_list(server: str) -> commands.Result:
    """List what waits, first what is next."""
    return commands.server_queue(commands.server_at(server))


@queue.command("move")
@click.argument("start")
@click.argument("place", type=click.IntRange(1, 1000))
@queue_option
@answers
def queue_move(start: str, place: int, server: str) -> commands.Result:
    """Move START (its id, or the unit that it is for) to a PLACE of the queue; 1 is next."""
    return commands.server_move(commands.server_at(server), start, place)


@queue.command("drop")
@click.argument("start")
@queue_option
@answers
def queue_drop(start: str, server: str) -> commands.Result:
    """Take START (its id, or the unit that it is for) out of the queue."""
    return commands.server_drop(commands.server_at(server), start)


@click.command()
@path_argument("folder")
@answers
def init(folder: Path) -> commands.Result:
    """Copy the shipped profiles, stations and models to FOLDER/profiles, for you to edit."""
    return commands.init(folder)


@click.command()
@station_option
@click.option("--modbus-port", type=click.IntRange(0, 65535), default=0, help="Port of the chamber; 0: any free one.")
@click.option("--can-port", type=click.IntRange(0, 65535), default=0, help="Port of the CAN bus; 0: any free one.")
@click.option("--speed", type=click.FloatRange(0.01, 1000.0), default=1.0, show_default=True, help="Times wall time.")
@path_option("--write-station", help="Write a station file for it here.")
@answers
def sim(
    station: Path | None, modbus_port: int, can_port: int, speed: float, write_station: Path | None
) -> commands.Result:
    """Serve the simulated station on 127.0.0.1 until Ctrl-C: Modbus TCP, and CAN as python-can's `loopcan`."""
    return commands.sim(station, (modbus_port, can_port), speed, write_station, _ready)


def _ready(served: acquisition.Served) -> None:
    """Print the addresses of the servers."""
    port, map_ = served.station.modbus_port, served.settings.chamber.map
    click.echo(f"chamber  Modbus TCP 127.0.0.1:{port} ({map_})", err=True)
    for name, channel in served.can_ports.items():
        click.echo(f"bus      {name}: python-can interface=loopcan channel={channel}", err=True)
    for name, line in served.lines.items():
        click.echo(f"line     {name}: {line}", err=True)
    click.echo("ready; Ctrl-C ends it", err=True)


@click.command()
@path_argument("station", required=False)
@click.option("--listen", "listen_s", type=click.FloatRange(0.1, 600.0), default=2.0, help="Seconds at each bus.")
@click.option("--contract", is_flag=True, help="Test the station's register map on a simulated controller instead.")
@path_option("--propose", help="Instead: listen to units that nobody described, and write their mapping to this file.")
@click.option("--notify", is_flag=True, help="Instead: send a trial to everybody whom the station tells of its runs.")
@answers
def doctor(
    station: Path | None, listen_s: float, contract: bool, propose: Path | None, notify: bool
) -> commands.Result:
    """Read the identity of the equipment of STATION and compare it with the file; writes nothing to it."""
    if notify:
        return commands.try_notices(station)
    if propose is not None:
        return commands.propose(station, listen_s, propose)
    return commands.contract(station) if contract else commands.doctor(station, listen_s)
