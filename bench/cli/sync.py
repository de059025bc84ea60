"""`bench sync`: runs of many benches in one place."""

from __future__ import annotations

from pathlib import Path

import click

from bench import commands
from bench.cli.options import answers, archive_options, out_option, path_argument

_HELP = "Folder, s3://bucket/path or sftp://host/path."
centre_option = click.option("--centre", "url", envvar="BENCH_CENTRE", required=True, metavar="URL", help=_HELP)


@click.group()
def sync() -> None:
    """Runs of many benches in one place, the centre: send, fetch, hash anew, keep raw data there only."""


@sync.command("send")
@centre_option
@out_option
@click.option("--moved", is_flag=True, help="The archive was moved here from the place that sent until now.")
@answers
def sync_send(url: str, out: Path, moved: bool) -> commands.Result:
    """Send what the centre lacks; a repetition goes on where it ended. Exit code 4: not reached, nothing is lost."""
    return commands.sync_send(url, out, moved=moved)


@sync.command("status")
@centre_option
@out_option
@answers
def sync_status(url: str, out: Path) -> commands.Result:
    """List what the centre lacks; by its last answer where it is not reached."""
    return commands.sync_status(url, out)


@sync.command("list")
@centre_option
@answers
def sync_list(url: str) -> commands.Result:
    """List what is at the centre, by ids that are the same everywhere."""
    return commands.sync_list(url)


@sync.command("fetch")
@click.argument("runs", metavar="[ID]...", nargs=-1)
@centre_option
@click.option("--large", is_flag=True, help="With raw data and reports; otherwise they stay at the centre.")
@click.option("--replace", is_flag=True, help="Also renew folders in which something was written here.")
@archive_options
@answers
def sync_fetch(
    runs: tuple[str, ...], url: str, large: bool, replace: bool, out: Path, where: str | None
) -> commands.Result:
    """Fetch all runs, or those of these IDs, into the archive --out."""
    return commands.sync_fetch(url, runs, out, where, large=large, replace=replace)


@sync.command("restore")
@path_argument("folders", metavar="RUN...", nargs=-1, required=True)
@click.option("--centre", "url", metavar="URL", help="Another centre than the one that the folder names.")
@answers
def sync_restore(folders: tuple[Path, ...], url: str | None) -> commands.Result:
    """Bring files of these folders back that are at a centre only."""
    return commands.sync_restore(folders, url)


@sync.command("release")
@centre_option
@click.option(
    "--older-than", "older_days", type=click.FloatRange(0), required=True, metavar="DAYS", help="Age of runs."
)
@out_option
@answers
def sync_release(url: str, older_days: float, out: Path) -> commands.Result:
    """Remove raw data of older runs here once each file at the centre has been hashed anew; the means stay."""
    return commands.sync_release(url, out, older_days)


@sync.command("scrub")
@centre_option
@click.option("--repair", is_flag=True, help="Set damaged files aside; benches that have them send them again.")
@answers
def sync_scrub(url: str, repair: bool) -> commands.Result:
    """Hash every file of the centre anew, and say each that is damaged or missing; exit code 1 where there is one."""
    return commands.sync_scrub(url, repair=repair)
