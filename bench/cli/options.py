"""Options that several commands share, and how an answer is printed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base import BenchError
from drivers.errors import ConfigError, DriverError, IdentityError, LimitError

if TYPE_CHECKING:
    from bench.commands import Answer

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
server_option = click.option(
    "--server",
    envvar="BENCH_SERVER",
    metavar="URL",
    help="Ask this `bench ui` (its token in BENCH_TOKEN) instead of this machine; RUN is UNIT/RUN there.",
)

registry_option = click.option(
    "--registry", "where", envvar="BENCH_REGISTRY", help="Registry: file, or postgresql://… [default: in --out]"
)


def registers(begin: bool) -> Callable[[Callable[..., Answer]], Callable[..., Answer]]:
    """Register the runs that a command's answer names; `begin` a registry where there is none."""

    def decorate(command: Callable[..., Answer]) -> Callable[..., Answer]:
        @wraps(command)
        def wrapped(*args: Any, where: str | None = None, **kwargs: Any) -> Answer:
            from bench.commands import registered

            return registered(command(*args, **kwargs), where, begin)

        return wrapped

    return decorate


def answers(command: Callable[..., Answer]) -> Callable[..., None]:
    """Print the answer as text or JSON; turn the errors of bench and drivers into one line and an exit code.

    Anything else is our bug and shows its traceback.
    """

    @wraps(command)
    def wrapped(*args: Any, as_json: bool = False, own_effects: tuple[str, ...] = (), **kwargs: Any) -> None:
        code: int
        try:
            if own_effects:
                from bench.analysis import load_effect

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
