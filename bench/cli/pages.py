"""`bench ui`: the bench in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.cli.options import answers, out_option

if TYPE_CHECKING:
    from bench.commands import Answer


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to bind to; another one needs --access.")
@click.option("--port", type=click.IntRange(0, 65535), default=8321, show_default=True, help="0: any free one.")
@out_option
@click.option("--access", type=click.Path(path_type=Path), help="Access file (YAML): names, roles, hashes of tokens.")
@click.option("--new-token", metavar="NAME", help="Print a new token for NAME once, store its hash in --access, end.")
@click.option("--role", type=click.Choice(["viewer", "operator", "engineer"]), help="Role of --new-token.")
@click.option("--name", "names", multiple=True, help="Further host name that browsers may use; may be repeated.")
@click.option("--certificate", type=click.Path(path_type=Path), help="TLS: certificate chain (PEM).")
@click.option("--key", type=click.Path(path_type=Path), help="TLS: key of the certificate (PEM).")
@click.option("--no-browser", is_flag=True, help="Open no browser.")
@answers
def ui(**wishes: Any) -> Answer:
    """Serve the bench to a browser: start and watch runs, find what a model lacks, look up units."""
    from bench.commands import Answer

    if wishes["new_token"] is not None:
        return Answer({}, _new_token(wishes["access"], wishes["new_token"], wishes["role"]))
    _serve(**wishes)
    return Answer({}, "ended; runs that were started go on: `bench status`")


def _new_token(access: Path | None, name: str, role: str | None) -> str:
    from bench.base import InputError
    from bench.web import add_person

    if access is None or role is None:
        raise InputError("--new-token NAME needs --access FILE (may be new) and --role viewer, operator or engineer")
    return add_person(access, name, role)  # type: ignore[arg-type]  # click has checked it


def _serve(**wishes: Any) -> None:
    from bench.base import InputError

    try:
        from bench.web import Settings, Tls, serve
    except ModuleNotFoundError as error:
        raise InputError(f"`bench ui` needs {error.name}; pip install 'gyro-thermal-bench[web]'") from error
    certificate, key = wishes["certificate"], wishes["key"]
    if (certificate is None) != (key is None):
        raise InputError("--certificate and --key belong together; give both or neither")
    tls = Tls(certificate, key) if certificate else None
    settings = Settings(wishes["out"].resolve(), access=wishes["access"], host=wishes["host"], names=wishes["names"])
    serve(settings, wishes["port"], tls, not wishes["no_browser"])
