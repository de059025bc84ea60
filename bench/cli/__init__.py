"""The command line: parses arguments, calls a command, prints its result. Heavy imports are inside the commands, so
that `--help` is fast.

Exit codes: 0 done and within limits; 1 done, outside limits; 2 bad input; 3 aborted by operator or guard (safe state
reached); 4 equipment failed. Every command with a result takes `--json`: one object on stdout, all else on stderr.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from typing import Any

import click

from bench.base import InputError, __version__
from bench.cli import analyse, deliver, measure, pages, stock, sync
from bench.cli.options import exits

SECTIONS: dict[str, Sequence[click.Command]] = {
    "Measure": (measure.run, measure.check, measure.doctor, measure.sim, measure.init),
    "Live runs": (measure.status, measure.hold, measure.pause, measure.resume, measure.abort, measure.queue),
    "Understand": (
        analyse.report, analyse.compare, analyse.noise, analyse.diagnose, analyse.decide, analyse.add, analyse.improve,
        analyse.effects, analyse.import_, analyse.imu, analyse.replay, analyse.diff, analyse.mystery, analyse.reveal,
    ),
    "Deliver": (deliver.calibrate, deliver.export, deliver.flash, deliver.verify, deliver.certificate),
    "In a browser": (pages.ui,),
    "Many units": (stock.fleet, stock.lot, stock.registry, stock.verify_archive, sync.sync),
}  # fmt: skip


class Sections(click.Group):
    """A group whose help lists its commands by purpose."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run the words of this process, or those given; SIGTERM ends a process of the bench's own in good order."""
        if not args and options.get("args") is None and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
        return super().main(*args, **options)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; words that it does not take are told in one line, as all bad input is."""
        as_json = "--json" in ctx.args
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            command = error.ctx.command_path if error.ctx else f"{ctx.command_path} {ctx.invoked_subcommand}"
            said = error.format_message()
            with exits(as_json):
                raise InputError(f"{said}{'' if said[-1] in '.?' else '.'} See `{command} --help`") from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """One table per section, in the order of the work."""
        width = max(len(name) for name in self.commands)
        room = formatter.width - 6 - width
        for title, commands in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl(
                    [(str(command.name).ljust(width), command.get_short_help_str(room)) for command in commands]
                )


@click.group("bench", cls=Sections, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="bench")
def main() -> None:
    """Thermal test bench for gyroscopes: run a chamber, capture without loss, fit, diagnose, calibrate.

    Start with `bench run profiles/ramp_-40_85.yaml`: it needs no equipment.
    """


for _commands in SECTIONS.values():
    for _command in _commands:
        main.add_command(_command)
