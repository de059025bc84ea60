"""Commands that compare runs with themselves and with each other: replay, diff."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench import archive
from bench.commands.files import tell_unproven
from bench.commands.results.analyse import Differs, Replayed


def replay_runs(runs: Sequence[Path], models: Sequence[str], others: Sequence[Path]) -> Replayed:
    """`bench replay`: the numbers of runs made again; `others` are further runs of their analyses."""
    from bench.commands.replay.replaying import replay as made_again

    tell_unproven(*runs)
    return Replayed(tuple(made_again(run, models, others) for run in runs))


def diff(a: Path, b: Path) -> Differs:
    """`bench diff`: only what differs between two runs, worst first."""
    tell_unproven(a, b)
    return Differs(archive.difference_of(a, b))
