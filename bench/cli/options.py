"""Options that several commands share, and the output of a command: text or JSON, and an exit code."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce, wraps
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

from bench import analysis, commands
from bench.base import BenchError, is_run_id
from bench.cli import completion
from drivers.errors import DriverError

json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, nothing else.")
C = TypeVar("C", bound=Callable[..., Any])


@dataclass(frozen=True)
class AtCentre:
    """A run of a centre, or all its runs, in place of a folder; fetched when the command begins."""

    text: str
    run: bool

    def folder(self) -> Path:
        """The folder on this computer."""
        return commands.run_of_centre(self.text) if self.run else commands.archive_of_centre(self.text)


class RunPath(click.Path):
    """A run folder, or a run of a centre: CENTRE#ID, or the id with BENCH_CENTRE set."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """What stands there."""
        at_centre = isinstance(value, str) and ("#" in value or is_run_id(value)) and not Path(value).exists()
        return AtCentre(value, run=True) if at_centre else super().convert(value, param, ctx)


class ArchivePath(click.Path):
    """A folder of run folders, or a centre: its URL, or its folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """What stands there."""
        at_centre = isinstance(value, str) and ("://" in value or (Path(value) / "centre.json").is_file())
        return AtCentre(value, run=False) if at_centre else super().convert(value, param, ctx)


def fetched(given: Mapping[str, Any]) -> dict[str, Any]:
    """The values of options and arguments, with the folders of what is at a centre."""

    def one(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(one(part) for part in value)
        return value.folder() if isinstance(value, AtCentre) else value

    return {name: one(value) for name, value in given.items()}


def path_option(name: str, *more: str, help: str, **options: Any) -> Callable[[C], C]:
    """An option that is a path."""
    return click.option(name, *more, type=click.Path(path_type=Path), help=help, **options)


def path_argument(name: str, **options: Any) -> Callable[[C], C]:
    """An argument that is a path."""
    return click.argument(name, type=click.Path(path_type=Path), **options)


def together(*options: Callable[[C], C]) -> Callable[[C], C]:
    """Several options as one decorator, in the order of the help text."""
    return lambda command: reduce(lambda made, option: option(made), reversed(options), command)


output_option = click.option(
    "--output", help="Which output of a unit with several: rate_x, rate_y or rate_z; default: the only one."
)
UNIT = "Serial number; NEW@KNOWN: a new unit in the slot of KNOWN."
station_option = path_option("--station", help="Station file (YAML); default: the embedded simulator.")
model_option = click.option(
    "--model",
    "models",
    multiple=True,
    shell_complete=completion.models,
    help="Model file or name; may be repeated. Default: the three of the papers.",
)
model_argument = click.option("--model", required=True, shell_complete=completion.models, help="Model file or name.")
RUN = RunPath(path_type=Path)
run_argument = click.argument("run_folder", type=RUN, metavar="RUN")
runs_argument = click.argument("runs", type=RUN, nargs=-1, required=True)
unseen_options = together(
    click.option("--check", "check_runs", type=RUN, multiple=True, help="Held-out run; repeatable."),
    click.option("--static", type=RUN, help="Isothermal run of the same unit; shows its noise."),
)
sister_option = click.option(
    "--sister", "sisters", type=RUN, multiple=True,
    help="Isothermal run of a unit like this one, repeatable: with --static, they show how the noise drifts.",
)  # fmt: skip
effect_option = click.option(
    "--effect",
    "own_effects",
    multiple=True,
    help="Own effect, file.py:Class; or those of a kind of gyro: fog, rlg, whole_angle.",
)
limits_option = path_option("--limits", help="Limits file (YAML); also gives a verdict against it.")
out_option = path_option("--out", default=Path("reports"), show_default=True, help="Folder of the run folders.")
quiet_option = click.option("--quiet", is_flag=True, help="No progress display.")
registry_option = click.option(
    "--registry", "where", envvar="BENCH_REGISTRY", help="Registry: file, or postgresql://… [default: in --out]"
)
archive_options = together(out_option, registry_option)
shelf_options = together(
    click.option(
        "--out",
        type=ArchivePath(path_type=Path),
        default=Path("reports"),
        show_default=True,
        help="Folder of the run folders, or a centre.",
    ),
    registry_option,
)
_SERVER = "Use this `bench ui` (token in BENCH_TOKEN) instead of this machine; RUN is then UNIT/RUN."
queue_option = click.option(
    "--server",
    envvar="BENCH_SERVER",
    metavar="URL",
    default="http://127.0.0.1:8321",
    show_default=True,
    help="The `bench ui` whose queue it is (token in BENCH_TOKEN).",
)
live_options = together(
    path_argument("run_folder", metavar="[RUN]", required=False),
    out_option,
    click.option("--server", envvar="BENCH_SERVER", metavar="URL", help=_SERVER),
)


@dataclass(frozen=True)
class Registered:
    """A result whose runs were registered; `warning` is the error if that failed."""

    result: commands.Result
    warning: str

    @property
    def exit_code(self) -> int:
        """Exit code of the result; a failing registry does not change it."""
        return self.result.exit_code


def registers(
    begin: bool, pass_on: bool = False
) -> Callable[[Callable[..., commands.Result]], Callable[..., commands.Result | Registered]]:
    """Register the runs of a command's result.

    `begin`: create a missing registry; `pass_on`: give the command the registry as `registry`.
    """

    def decorate(command: Callable[..., commands.Result]) -> Callable[..., commands.Result | Registered]:
        @registry_option
        @wraps(command)
        def wrapped(*args: Any, where: str | None = None, **kwargs: Any) -> commands.Result | Registered:
            result = command(*args, **kwargs, **({"registry": where} if pass_on else {}))
            warning = commands.register_runs(result.runs, where, begin)
            return result if warning is None else Registered(result, warning)

        return wrapped

    return decorate


def answers(command: Callable[..., commands.Result | Registered]) -> Callable[..., None]:
    """Give a command `--json` and print its result; user-defined effects are loaded first."""

    @json_option
    @wraps(command)
    def wrapped(*args: Any, as_json: bool, own_effects: tuple[str, ...] = (), **kwargs: Any) -> None:
        def work() -> commands.Result | Registered:
            if own_effects:
                for spec in own_effects:
                    analysis.load_effect(spec)
            return command(*args, **fetched(kwargs))

        answer(work, as_json)

    return wrapped


def answer(work: Callable[[], commands.Result | Registered], as_json: bool) -> NoReturn:
    """Print a result and end with its exit code. An error of another class is a bug and shows its traceback."""
    with exits(as_json):
        result = work()
        from bench.cli import rendering

        if as_json:
            click.echo(json.dumps(rendering.content(result), allow_nan=False))
        else:
            rendering.show(result)
    sys.exit(result.exit_code)


class exits:  # noqa: N801 - a context manager, named like a function
    """Turn an error of bench or drivers into one line on stderr and its exit code; with `as_json` also into JSON."""

    def __init__(self, as_json: bool = False) -> None:
        self._as_json = as_json

    def __enter__(self) -> None:
        """Nothing to do."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Raises SystemExit for an error that has an exit code."""
        if isinstance(error, BenchError | DriverError):
            self._end(str(error), error.exit_code)
        if isinstance(error, OSError) and error.filename is not None:
            # A folder that cannot be written, a file that is a folder: the user's disk, not a bug.
            self._end(f"{error.filename}: cannot be read or written: {error.strerror}", 2)

    def _end(self, text: str, code: int) -> NoReturn:
        print(f"bench: {text}", file=sys.stderr)
        if self._as_json:
            click.echo(json.dumps({"error": text, "exit_code": code}))
        sys.exit(code)
