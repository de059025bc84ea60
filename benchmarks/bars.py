"""The bars of the campaign: target, measured value, and whether it was reached."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.stats import binomtest

from bench.mystery.hidden import HIDDEN
from benchmarks.scores import Result, both, decided, inside, named, tie, tied, unknown


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = ["", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def bars(results: Sequence[Result]) -> str:
    """The section with all bars."""
    clean, pairs, second = ([r for r in results if r["kind"] == kind] for kind in ("clean", "pair", "second"))
    single = [r for r in results if r["kind"] == "single"]
    at = {s: [r for r in inside(single) if r["strength"] == s] for s in (0.5, 1.0)}
    outside = [r for r in single if r["strength"] == 1.0 and HIDDEN[r["hidden"][0]].effect is None]
    held = [r for r in at[1.0] if named(r) and r.get("held_named") and r.get("held_true")]
    rows = [
        _bar("right family named at strength 1", 0.98, at[1.0], named),
        _bar("found at strength 1: the tie set holds the truth", 0.97, [r for r in at[1.0] if r["found"]], tie),
        _bar("found and named at strength 0.5", 0.77, at[0.5], named),
        _bar("clean runs wrongly named", -0.02, clean, lambda r: bool(r["found"])),
        _bar("clean runs with any alarm", -0.05, clean, lambda r: r["verdict"] != "adequate"),
        _bar("outside the library reported as unknown at strength 1, a close relative of the lag left out", 0.9,
             [r for r in outside if r["hidden"][0] != "two_pole_lag"], unknown),
        _bar("the same for periodic, (dT/dt)^2, etalon and unlogged drift alone", 0.9,
             [r for r in outside if r["hidden"][0] not in ("two_pole_lag", "emi")], unknown),
        _bar("two effects of strength 1 at once, both found", 0.8, pairs, both),
        _bar("weak ties after one ramp decided by the run that the bench proposes", 0.9, tied(second),
             lambda r: decided(r, "after")),
    ]  # fmt: skip
    ratios = [r["held_named"] / r["held_true"] for r in held]
    rows.append(_number("error on an unseen run over the true model's at strength 1, median", 1.05, ratios, 0.5))
    rows.append(_number("the same, 95 % of the cases", 1.05, ratios, 0.95))
    seconds = [r["processor_s"] for r in single if "processor_s" in r]
    rows.append(_number("processor time of a diagnosis, median [s]", 20.0, seconds, 0.5))
    listed = table(("", "bar", "measured", "95 % interval", "cases", "reached"), rows)
    return f"## Bars\n{listed}\n\nNot named at strength 1: {_missed(at[1.0])}."


def _missed(single: Sequence[Result]) -> str:
    """Every effect that was missed, how often, and the answers given instead."""
    answers: dict[str, list[str]] = {}
    for result in single:
        if not named(result):
            answers.setdefault(result["hidden"][0], []).append(", ".join(result["found"]) or "nothing found")
    cases = Counter(result["hidden"][0] for result in single)
    words = (f"{name} in {len(each)} of {cases[name]} ({_counted(each)})" for name, each in answers.items())
    return "; ".join(words) or "none"


def _counted(words: Sequence[str]) -> str:
    return ", ".join(f"{count} x {word}" for word, count in Counter(words).most_common())


def _bar(words: str, bar: float, results: Sequence[Result], true: Callable[[Result], bool]) -> tuple[str, ...]:
    """A share with its interval (Wilson); a negative bar is an upper limit, not a lower one."""
    asked = f"{'at least' if bar > 0 else 'at most'} {abs(100 * bar):.0f} %"
    if not results:
        return (words, asked, "–", "–", "0", "not measured")
    test = binomtest(sum(map(true, results)), len(results))
    low, high = test.proportion_ci(method="wilson")
    reached = test.statistic >= bar if bar > 0 else test.statistic <= -bar
    excluded = high < bar if bar > 0 else low > -bar
    verdict = "yes" if reached else "**no**" if excluded else "not excluded"
    interval = f"{100 * low:.1f} to {100 * high:.1f} %"
    return (words, asked, f"{100 * test.statistic:.1f} %", interval, str(len(results)), verdict)


def _number(words: str, most: float, values: Sequence[float], quantile: float) -> tuple[str, ...]:
    if not values:
        return (words, f"at most {most:g}", "–", "–", "0", "not measured")
    found = float(np.quantile(values, quantile))
    return (words, f"at most {most:g}", f"{found:.3g}", "–", str(len(values)), "yes" if found <= most else "**no**")
