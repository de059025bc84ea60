"""Commands that hold runs against themselves and each other: replay, diff."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.commands.answer import Answer


def replay_runs(runs: Sequence[Path], models: Sequence[str], others: Sequence[Path]) -> Answer:
    """`bench replay`: exit code 1 where a number of a run is not the same again."""
    from bench.commands.replay.replaying import lines
    from bench.commands.replay.replaying import replay as made_again

    found = [made_again(run, models, others) for run in runs]
    identical = all(one.identical for one in found)
    text = "\n".join(line for one in found for line in lines(one))
    return Answer({"identical": identical, "runs": [one.to_json() for one in found]}, text, 0 if identical else 1)


def diff(a: Path, b: Path) -> Answer:
    """`bench diff`: only what differs between two runs, worst first."""
    from bench.archive import difference_of, lines

    found = difference_of(a, b)
    return Answer(found, "\n".join(lines(found)))
