"""The missing effect named by the bench, by SysIdentPy and by pysindy, on the same run in 30 s means.

The peers get the columns of the bench's library on a grid of their parameters (benchmarks.peers), which is part of
their work; the time of the bench also includes work that they do not do: noise, whitening, held-out blocks,
look-alikes, parameters with uncertainty. How often each of them is right is in docs/hidden_effects.md; here the error
is 1 if another effect comes first.
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from bench.record.dataset import Dataset
from benchmarks.rounds import Case, Method, Table, compared, measured

HIDDEN, STRENGTH = "thermal_lag", 1.5


class Given(NamedTuple):
    """A run with the hidden effect, and an isothermal one of the same unit."""

    run: Dataset
    still: Dataset


def load(folder: Path) -> Given:
    return Given(*pickle.loads((folder / "runs.pickle").read_bytes()))


def short(given: Given) -> Given:
    """A quarter of the run: enough to import everything."""
    keep = given.run.time < given.run.time[given.run.time.size // 4]
    return Given(given.run.select(keep), given.still)


def ours(given: Given) -> tuple[str, ...]:
    from bench.analysis.diagnosis.diagnose import diagnose
    from benchmarks.trials import MODEL

    return tuple(suspect.effect for suspect in diagnose([given.run], MODEL, static=given.still).suspects)


def peer(name: str) -> Callable[[Given], tuple[str, ...]]:
    def choose(given: Given) -> tuple[str, ...]:
        from benchmarks import peers
        from benchmarks.trials import MODEL

        chosen: Any = getattr(peers, name)(peers.shelf(given.run, MODEL))
        return tuple(chosen.ranking)

    return choose


def wrong(answer: tuple[str, ...], given: Given, folder: Path) -> float:
    return float(answer[:1] != (HIDDEN,))


CASES = {
    f"one hidden {HIDDEN}": Case(
        load,
        short,
        {
            "bench diagnose": Method(ours),
            "SysIdentPy FROLS": Method(peer("frols"), ("sysidentpy",)),
            "pysindy STLSQ, 8 thresholds": Method(peer("stlsq"), ("pysindy",)),
        },
        wrong,
    )
}


def tables(quick: bool) -> list[Table]:
    from benchmarks import cases
    from benchmarks.trials import MODEL

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        unit = cases.case((HIDDEN,), STRENGTH, 1, cases.ONE_RATE, MODEL)
        runs = unit.run(cases.ONE_RATE), unit.quiet(cases.STATIC, 1)
        (folder / "runs.pickle").write_bytes(pickle.dumps(runs))
        found = measured("benchmarks.naming", folder, CASES, 1 if quick else 2)
    reading = (
        f"{runs[0].time.size:,} means of 30 s; the error is 0 if {HIDDEN} comes first, otherwise 1; the "
        "peers only rank columns, without noise floor, whitening, held-out blocks or uncertainties."
    )
    return [compared("Naming the effect, beside SysIdentPy and pysindy", reading, found)]
