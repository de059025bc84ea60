"""Is the gyro blamed for what the thermometer, the clock or the resolution of the logger did?

    python -m benchmarks.traps --seeds 5 --out traps.jsonl

Every trap is a unit of the simulated truth whose *recording* is wrong in one way, or whose mechanism acts in a way that
is no plain row of the catalogue: sensors integrate, count relays and round at 10 Hz or 1 Hz, and share no formula with
the effects. Sizes are such that a static spline leaves `--strength` times the noise, where the size matters. Beside the
run there is an isothermal run and a check run of another profile, recorded in the same way. Counted is whether the
first name is right or a declared tie, and whether "Missing:" stands before a wrong name. Results are appended to the
file as they come; what stands there already is not run again. Prints one JSON object with n; exit code 1 where the
95 % interval of the share of wrong names lies above 5 %.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from benchmarks import campaigns, recordings
from benchmarks.recordings import TRAPS

BAR = 0.05
UNDECIDED = ("undecided", "unknown_effect")


@dataclass(frozen=True)
class Case:
    """One diagnosis."""

    trap: str
    seed: int
    strength: float = 1.0


def cases(seeds: int, traps: Sequence[str] = (), strengths: Sequence[float] = (1.0,)) -> Iterator[Case]:
    """Seed by seed, so that a campaign cut short is a smaller campaign."""
    for seed in range(1, seeds + 1):
        for name in traps or TRAPS:
            yield from (Case(name, seed, strength) for strength in strengths)


def run_case(case: Case) -> dict[str, Any]:
    """What the bench says of this trap."""
    from bench.analysis.diagnosis.diagnose import diagnose
    from benchmarks.trials import MODEL

    runs = recordings.recorded(TRAPS[case.trap], case.seed, case.strength, MODEL)
    began = time.process_time()
    answer = diagnose([runs.run], MODEL, check=[runs.check], static=runs.static)
    spent = time.process_time() - began
    content = answer.to_json()
    named = [s["effect"] for s in content["suspects"] if s["found"]]
    alike = sorted({name for s in content["suspects"] if s["found"] for name in s["look_alikes"]})
    return {
        "verdict": content["verdict"],
        "proved": content.get("proved"),
        "named": named,
        "alike": alike,
        "suspects": [(s["effect"], round(s["evidence"], 1)) for s in content["suspects"]],
        "sentence": content["sentence"],
        "notes": content["notes"],
        "held_out": [content["held_out_rms_dph"], content["floor_dph"]],
        "processor_s": round(spent, 2),
    }


def judged(trap: str, found: dict[str, Any]) -> str:
    """right, tie, wrong, unproved (a wrong name that is not called missing), undecided or nothing."""
    right = set(TRAPS[trap].right)
    named = found["named"]
    headline = found["verdict"] == "missing_effect" and bool(named) and found.get("proved") is not False
    if named and set(named) <= right and named[0] in right:
        return "right"
    if named and (named[0] in right or right & set(found["alike"])):
        return "tie" if named[0] not in right else ("right" if not headline or len(named) == 1 else "beside")
    if headline:
        return "wrong"
    if found["verdict"] in UNDECIDED:
        return "undecided"
    return "unproved" if named else "nothing"


WORDS = ("right", "tie", "beside", "nothing", "undecided", "unproved", "wrong")


def table(results: Sequence[tuple[Case, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Counts of each trap, then of all."""
    names = [name for name in TRAPS if any(case.trap == name for case, _ in results)]
    rows = [_row(name, TRAPS[name].kind, [r for r in results if r[0].trap == name]) for name in names]
    return [*rows, _row("all", "", results)]


def _row(name: str, kind: str, mine: Sequence[tuple[Case, dict[str, Any]]]) -> dict[str, Any]:
    words = [judged(case.trap, found) for case, found in mine]
    wrong = binomtest(words.count("wrong"), max(len(words), 1)).proportion_ci(0.95, method="exact")
    cpu = [found["processor_s"] for _, found in mine]
    return {
        "trap": name, "kind": kind, "n": len(words), **{word: words.count(word) for word in WORDS},
        "wrong_share": round(words.count("wrong") / max(len(words), 1), 4),
        "wrong_interval": [round(wrong.low, 4), round(wrong.high, 4)],
        "processor_s": round(sum(cpu) / max(len(cpu), 1), 2),
    }  # fmt: skip


def section(path: Path) -> str:
    """This part of docs/hidden_effects.md; empty without results."""
    results = campaigns.read(path, lambda c: (_case(c), c["found"])) if path.is_file() else []
    if not results:
        return ""
    rows = table(results)
    total = rows[-1]
    low, high = (100 * end for end in total["wrong_interval"])
    lines = [
        "## Traps: thermometer, clock, resolution, part of the range, pairs",
        "",
        "Written from the results of `python -m benchmarks.traps`. The recording is wrong in one way, or a mechanism "
        "acts as no plain row of the catalogue does; sensors integrate, count relays and round on their own. *Right*: "
        "only right names; *tie*: the truth is a declared look-alike; *beside*: right first, a further name beside it; "
        "*undecided*: unknown or undecided; *unproved*: a wrong name that is not called missing.",
        "",
        f'Wrong "Missing:" in {total["wrong"]} of {total["n"]} ({100 * total["wrong_share"]:.1f} %, 95 % interval '
        f"{low:.1f} to {high:.1f} %); bar: at most 5 %.",
        "",
        f"| trap | kind | right names | n | {' | '.join(WORDS)} |",
        f"|---|---|---|---|{'---|' * len(WORDS)}",
    ]
    for row in rows:
        right = ", ".join(TRAPS[row["trap"]].right) or "none" if row["trap"] in TRAPS else ""
        counts = " | ".join(str(row[word]) for word in WORDS)
        lines.append(f"| {row['trap']} | {row['kind']} | {right} | {row['n']} | {counts} |")
    return "\n".join(lines) + "\n"


def _case(content: dict[str, Any]) -> Case:
    return Case(**{key: value for key, value in content.items() if key != "found"})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--strength", type=float, action="append", default=[], help="times the noise; repeatable")
    parser.add_argument("--trap", action="append", default=[], choices=sorted(TRAPS), help="only this; repeatable")
    parser.add_argument("--out", type=Path, default=Path("traps.jsonl"))
    parser.add_argument("--verbose", action="store_true", help="print each answer as it comes")
    arguments = parser.parse_args()
    todo = cases(arguments.seeds, arguments.trap, arguments.strength or (1.0,))

    def run(case: Case) -> dict[str, Any]:
        found = run_case(case)
        if arguments.verbose:
            print(case.trap, case.seed, case.strength, judged(case.trap, found), found["verdict"], found["proved"],
                  found["suspects"], found["processor_s"], file=sys.stderr, flush=True)  # fmt: skip
        return found

    rows = table(campaigns.found(todo, run, arguments.out, Case))
    print(json.dumps({"bar": BAR, "table": rows}, indent=1))
    return 1 if rows[-1]["wrong_interval"][0] > BAR else 0


if __name__ == "__main__":
    sys.exit(main())
