"""Ageing as large as the noise, and nothing hidden, with isothermal runs of sister units beside the unit's own.

    python -m benchmarks.sister_noise --seeds 24 --out sister_noise.jsonl

The noise coefficients of the sisters scatter by ten per cent (1 sigma) about those of the unit. Results are appended to
the file as they come; what stands there already is not run again. Prints one JSON object.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from bench.analysis.diagnosis.diagnose import diagnose
from bench.mystery.hidden import NOISE
from bench.record.dataset import Dataset
from benchmarks import campaigns, cases
from benchmarks.bars import table
from benchmarks.trials import MODEL

SISTERS = (0, 5, 10)
SPREAD = 0.1


@dataclass(frozen=True)
class Trial:
    """A unit with ageing of strength 1 or nothing hidden, and how many sisters have isothermal runs."""

    hidden: str
    sisters: int
    seed: int


def run_trial(trial: Trial) -> dict[str, Any]:
    """What the bench answers."""
    hidden = (trial.hidden,) if trial.hidden else ()
    case = cases.case(hidden, float(bool(hidden)), trial.seed, cases.TWO_RATES, MODEL)
    found = diagnose(
        [case.run(cases.TWO_RATES)], MODEL, static=case.quiet(cases.STATIC, 4),
        sisters=[_sister(trial.seed, number) for number in range(trial.sisters)],
    )  # fmt: skip
    first = next((s for s in found.suspects if s.effect == "aging"), None)
    return {
        "verdict": found.verdict,
        "found": [suspect.effect for suspect in found.found],
        "evidence": None if first is None else round(first.evidence, 1),
        "left_out": sum("was left out" in note for note in found.notes),
    }


def _sister(seed: int, number: int) -> Dataset:
    rng = np.random.default_rng([seed, number, 41])
    noise = {name: value * float(np.exp(SPREAD * rng.standard_normal())) for name, value in NOISE.items()}
    return cases.recorded([], noise, cases.STATIC, 100_000 * seed + number)


def trials(seeds: int) -> Iterator[Trial]:
    """Seed by seed, so that an interrupted campaign is a smaller campaign."""
    for seed in range(1, seeds + 1):
        yield from (Trial(hidden, sisters, seed) for sisters in SISTERS for hidden in ("aging", ""))


def section(path: Path) -> str:
    """Part of docs/hidden_effects.md; empty without results."""
    results = campaigns.known(path, Trial)
    if not results:
        return ""
    rows = []
    for sisters in SISTERS:
        own = [(trial, found) for trial, found in results if trial.sisters == sisters]
        aged = [found for trial, found in own if trial.hidden]
        clean = [found for trial, found in own if not trial.hidden]
        if aged and clean:
            rows.append((
                str(sisters), str(len(aged)), _share([one["found"] == ["aging"] for one in aged]),
                f"{np.median([one['evidence'] for one in aged]):.1f}",
                str(len(clean)), _share([bool(one["found"]) for one in clean]),
            ))  # fmt: skip
    head = ("isothermal runs of sisters", "aged units", "ageing named, and nothing else", "evidence, median",
            "clean units", "anything named")  # fmt: skip
    return (
        "## Ageing of strength 1, with the noise of sister units\n\n`python -m benchmarks.sister_noise`: what "
        "`--sister` adds. The sisters' noise coefficients scatter by 10 % from unit to unit; every unit has an "
        f"isothermal run of its own, too. In brackets the 95 % interval.\n{table(head, rows)}\n"
    )


def _share(right: list[bool]) -> str:
    ends = binomtest(sum(right), len(right)).proportion_ci(method="wilson")
    return f"{sum(right)} ({100 * ends.low:.0f} to {100 * ends.high:.0f} %)"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--out", type=Path, default=Path("sister_noise.jsonl"))
    options = parser.parse_args()
    campaigns.found(trials(options.seeds), run_trial, options.out, Trial)
    print(json.dumps({"table": section(options.out)}, indent=1))


if __name__ == "__main__":
    main()
