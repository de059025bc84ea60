"""Commands that need equipment, real or simulated: run, check, live runs, doctor, sim; and init."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.cli.options import (
    answers,
    effect_option,
    limits_option,
    live_options,
    model_option,
    out_option,
    path_argument,
    path_option,
    quiet_option,
    registers,
    station_option,
)

if TYPE_CHECKING:
    from bench.acquisition import Served
    from bench.commands import Result


@click.command()
@path_argument("profile")
@station_option
@click.option("--unit", "serials", multiple=True, help="Serial number; may be repeated. Default: all of the station.")
@model_option
@limits_option
@click.option("--production", is_flag=True, help="Refuse to start without valid equipment.")
@path_option("--equipment", help="Equipment with due dates (YAML) [production: registry's]")
@effect_option
@out_option
@quiet_option
@click.option("--operator", default="", help="Who starts it, for the record. Default: the user.")
@answers
@registers(begin=True, tell=True)
def run(profile: Path, station: Path | None, out: Path, quiet: bool, **options: Any) -> Result:
    """Run PROFILE: drive the chamber, capture the units, fit the models, write the reports."""
    from bench import commands

    return commands.run_profile(profile, station, commands.RunOptions(**options), out, quiet)


@click.command()
@path_argument("profile")
@station_option
@answers
def check(profile: Path, station: Path | None) -> Result:
    """Say everything about PROFILE that can be known before anything moves."""
    from bench import commands

    return commands.check(profile, station)


@click.command()
@live_options
@answers
def status(run_folder: Path | None, out: Path, server: str | None) -> Result:
    """What a live RUN does just now; without RUN: all of them."""
    from bench import commands

    if server:
        return commands.server_status(commands.server_at(server), run_folder)
    return commands.status(run_folder, out)


@click.command()
@live_options
@answers
def hold(run_folder: Path | None, out: Path, server: str | None) -> Result:
    """Hold a live RUN at once, where its chamber is; without RUN: the only one."""
    return _act("hold", run_folder, out, server)


@click.command()
@live_options
@answers
def pause(run_folder: Path | None, out: Path, server: str | None) -> Result:
    """Hold a live RUN after its present segment; without RUN: the only one."""
    return _act("pause", run_folder, out, server)


def _act(action: str, run_folder: Path | None, out: Path, server: str | None) -> Result:
    """Ask a live run for something, through a server where one is named."""
    from bench import commands

    if server:
        return commands.server_act(commands.server_at(server), action, run_folder)
    return commands.act_on_run(action, run_folder, out)


@click.command()
@live_options
@path_option("--station", help="Station file, where the one of the run is outdated.")
@effect_option
@quiet_option
@answers
@registers(begin=True)
def resume(run_folder: Path | None, station: Path | None, out: Path, server: str | None, quiet: bool) -> Result:
    """Go on: with a live RUN that holds, or with one whose bench was killed, from where its journals end."""
    if server:
        return _act("resume", run_folder, out, server)
    from bench import commands

    return commands.resume(run_folder, station, out, quiet)


@click.command()
@live_options
@answers
def abort(run_folder: Path | None, out: Path, server: str | None) -> Result:
    """End a live RUN and say what the safe state reached; asks nothing. Without RUN: the only one."""
    from bench import commands

    if server:
        return commands.server_abort(commands.server_at(server), run_folder)
    return commands.abort(run_folder, out)


@click.command()
@path_argument("folder")
@answers
def init(folder: Path) -> Result:
    """Copy the shipped profiles, stations and models to FOLDER/profiles, as your own."""
    from bench import commands

    return commands.init(folder)


@click.command()
@station_option
@click.option("--modbus-port", type=click.IntRange(0, 65535), default=0, help="Port of the chamber; 0: any free one.")
@click.option("--can-port", type=click.IntRange(0, 65535), default=0, help="Port of the CAN bus; 0: any free one.")
@click.option("--speed", type=click.FloatRange(0.01, 1000.0), default=1.0, show_default=True, help="Times wall time.")
@path_option("--write-station", help="Write the station file that drives it.")
@answers
def sim(station: Path | None, modbus_port: int, can_port: int, speed: float, write_station: Path | None) -> Result:
    """Serve the simulated station on 127.0.0.1 until Ctrl-C: Modbus TCP, and CAN as python-can's `loopcan`."""
    from bench import commands

    return commands.sim(station, (modbus_port, can_port), speed, write_station, _ready)


def _ready(served: Served) -> None:
    """Say where the servers are."""
    port, map_ = served.station.modbus_port, served.settings.chamber.map
    click.echo(f"chamber  Modbus TCP 127.0.0.1:{port} ({map_})", err=True)
    for name, channel in served.can_ports.items():
        click.echo(f"bus      {name}: python-can interface=loopcan channel={channel}", err=True)
    click.echo("ready; Ctrl-C ends it", err=True)


@click.command()
@path_argument("station", required=False)
@click.option("--listen", "listen_s", type=click.FloatRange(0.1, 600.0), default=2.0, help="Seconds at each bus.")
@click.option("--contract", is_flag=True, help="Try the station's register map on a simulated controller instead.")
@answers
def doctor(station: Path | None, listen_s: float, contract: bool) -> Result:
    """Ask the equipment of STATION what it is, read-only, and say what agrees with the file and what does not."""
    from bench import commands

    return commands.contract(station) if contract else commands.doctor(station, listen_s)
