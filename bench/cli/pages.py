"""`bench ui`: the bench in a browser."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench import web
from bench.base import InputError
from bench.cli.options import exits, fetched, path_option, shelf_options

if TYPE_CHECKING:
    from bench.web import Role


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to bind to; any other needs --access.")
@click.option("--port", type=click.IntRange(0, 65535), default=8321, show_default=True, help="0: any free one.")
@shelf_options
@path_option("--access", help="Access file (YAML): names, roles, hashes of tokens.")
@click.option("--new-token", metavar="NAME", help="Print a new token for NAME once, store its hash in --access, end.")
@click.option("--new-pin", metavar="NAME", help="Print a PIN of NAME for a screen that is signed in, and end.")
@click.option("--badge", metavar="NUMBER", help="With --new-pin: what the reader types for a badge, in place of a PIN.")
@click.option("--role", type=click.Choice(["viewer", "operator", "engineer"]), help="Role of a new token or PIN.")
@click.option("--name", "names", multiple=True, help="Further host name that browsers may use; may be repeated.")
@click.option("--behind", metavar="ADDRESS", help="Reverse proxy whose X-Forwarded-For is believed; it speaks TLS.")
@path_option("--certificate", help="TLS: certificate chain (PEM).")
@path_option("--key", help="TLS: key of the certificate (PEM).")
@click.option("--no-browser", is_flag=True, help="Do not open a browser.")
def ui(new_token: str | None, new_pin: str | None, badge: str | None, role: Role | None, **options: Any) -> None:
    """Serve the bench to a browser: start and watch runs, find missing effects, look up units."""
    with exits():
        if new_token is not None:
            click.echo(_new_token(options["access"], new_token, role))
        elif new_pin is not None:
            click.echo(_new_pin(options["access"], new_pin, role, badge))
        else:
            _serve(**fetched(options))
            click.echo("ended; runs that were started continue: `bench status`")


def _check_address(behind: str) -> None:
    try:
        ipaddress.ip_address(behind)
    except ValueError:
        raise InputError(f"--behind is {behind!r}, must be the IP address that the proxy asks from") from None


def _new_token(access: Path | None, name: str, role: Role | None) -> str:
    if access is None or role is None:
        raise InputError("--new-token NAME needs --access FILE (may be new) and --role viewer, operator or engineer")
    return web.add_person(access, name, role)


def _new_pin(access: Path | None, name: str, role: Role | None, badge: str | None) -> str:
    if access is None or role is None or role == "engineer":
        raise InputError("--new-pin NAME needs --access FILE and --role viewer or operator; a PIN gives no more")
    return web.add_pin(access, name, role, badge)


def _serve(
    out: Path,
    where: str | None,
    certificate: Path | None,
    key: Path | None,
    port: int,
    no_browser: bool,
    **options: Any,
) -> None:
    if (certificate is None) != (key is None):
        raise InputError("--certificate and --key belong together; give both or neither")
    if options["behind"] is not None:
        _check_address(options["behind"])
    if where is not None:
        os.environ["BENCH_REGISTRY"] = where  # of the runs that the page starts
    try:
        from bench.web import Settings, Tls, serve

        tls = Tls(certificate, key) if certificate and key else None
        serve(Settings(out.resolve(), where, **options), port, tls, not no_browser)
    except ModuleNotFoundError as error:
        raise InputError(f"`bench ui` needs {error.name}; pip install 'gyro-thermal-bench[web]'") from error
