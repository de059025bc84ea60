"""The table of the campaign, from its cached results: docs/hidden_effects.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from bench.effects import make
from bench.hidden import HIDDEN
from benchmarks.peers import STLSQ_THRESHOLDS

Result = dict[str, Any]
_PEERS = ("frols", "stlsq")
_LEVEL = 0.95  # of clean runs below a peer's threshold

_HEAD = """# Hidden effects: how often the bench names them

Written by `python -m benchmarks.hidden_effects`; {cases} cases, {seeds} seeds. Every case is a simulated unit whose
truth integrates states of its own and shares no formula with the analysis. The model diagnosed is a static spline with
8 intervals; beside the run there is an isothermal run of three hours. Noise: 0.01 deg/sqrt(h), 0.03 deg/h, 0.03
deg/h/sqrt(h).

*Strength* is the RMS of the part of the effect that the static spline cannot absorb, divided by the RMS of the noise.
*Named* is found and right: the first of the effects found belongs to the hidden family. *Tie* counts the truth among
the effects found or their declared look-alikes, of the cases in which anything was found. The isothermal run is one in
which the hidden effect is not excited.
"""
_PEERS_NOTE = """
The peers get the bench's own library of regressors, its nonlinear parameters on a grid, made orthogonal to the spline,
and the spline's residual. *FROLS* is SysIdentPy's, the number of terms chosen by its BIC. *STLSQ* is pysindy's, its
threshold chosen by BIC from {thresholds}. Both name something unasked on most clean runs (table below): each gets the
score threshold that 95 % of the clean runs here stay under: {frols} for FROLS' first error reduction ratio, {stlsq} for
STLSQ's largest coefficient. *first* is the share of cases in which its first choice is right, *named* with that
threshold.
"""


def document(results: Sequence[Result]) -> str:
    """The whole page, as Markdown."""
    clean = [r for r in results if r["kind"] == "clean"]
    single = [r for r in results if r["kind"] == "single"]
    limits = {peer: _limit(clean, peer) for peer in _PEERS}
    seeds = len({r["seed"] for r in results if r["kind"] != "clean"})
    parts = [_HEAD.format(cases=len(results), seeds=seeds)]
    parts.append(_bars(results))
    parts.append("## All effects of the library together\n" + _strengths(_inside(single), limits))
    parts.append(
        _PEERS_NOTE.format(
            thresholds=", ".join(f"{t:g}" for t in STLSQ_THRESHOLDS),
            **{peer: f"{limits[peer]:.3g}" for peer in _PEERS},
        )
    )
    parts.append("## Nothing hidden\n" + _clean(clean))
    for profile in dict.fromkeys(r["profile"] for r in single):
        own = [r for r in single if r["profile"] == profile]
        parts.append(
            f"## Effect by effect, profile `{profile}`: named / tie holds the truth\n" + _effects(_inside(own))
        )
        parts.append(f"## Outside the library, profile `{profile}`: `unknown` said\n" + _outside(own))
    parts.append("## Error on a run that no fit saw, over its noise (median)\n" + _held_out(_inside(single)))
    parts.append("## Two effects at once, strength 1 each\n" + _pairs([r for r in results if r["kind"] == "pair"]))
    parts.append(
        "## The second run, after one ramp at one rate\n" + _second([r for r in results if r["kind"] == "second"])
    )
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def _family(effect: str) -> str:
    return make(effect).family


def _hidden_families(result: Result) -> set[str]:
    names = [HIDDEN[name].effect for name in result["hidden"]]
    return {_family(name) for name in names if name}


def _inside(results: Iterable[Result]) -> list[Result]:
    return [r for r in results if all(HIDDEN[name].effect for name in r["hidden"])]


def _named(result: Result) -> bool:
    return bool(result["found"]) and _family(result["found"][0]) in _hidden_families(result)


def _tie(result: Result) -> bool:
    return bool({_family(n) for n in (*result["found"], *result["alike"])} & _hidden_families(result))


def _unknown(result: Result) -> bool:
    return bool(result["verdict"] == "unknown_effect")


def _first(result: Result) -> bool:
    return bool(result["suspects"]) and _family(result["suspects"][0]["effect"]) in _hidden_families(result)


def _in_three(result: Result) -> bool:
    return bool({_family(s["effect"]) for s in result["suspects"][:3]} & _hidden_families(result)) or _tie(result)


def _peer_first(result: Result, peer: str) -> bool:
    ranking = result[peer]["ranking"]
    return bool(ranking) and _family(ranking[0]) in _hidden_families(result)


def _limit(clean: Sequence[Result], peer: str) -> float:
    scores = [r[peer]["score"] for r in clean if peer in r]
    return float(np.quantile(scores, _LEVEL)) if scores else float("nan")


def _share(results: Sequence[Result], true: Callable[[Result], bool]) -> str:
    if not results:
        return "–"
    return f"{100.0 * sum(map(true, results)) / len(results):.0f} %"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["", f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def _bars(results: Sequence[Result]) -> str:
    clean, pairs, second = ([r for r in results if r["kind"] == kind] for kind in ("clean", "pair", "second"))
    single = [r for r in results if r["kind"] == "single"]
    at = {s: [r for r in _inside(single) if r["strength"] == s] for s in (0.5, 1.0)}
    outside = [r for r in single if r["strength"] == 1.0 and HIDDEN[r["hidden"][0]].effect is None]
    held = [r for r in at[1.0] if _named(r) and r.get("held_named") and r.get("held_true")]
    rows = [
        _bar("right family named at strength 1", 0.98, at[1.0], _named),
        _bar("found at strength 1: the tie set holds the truth", 0.97, [r for r in at[1.0] if r["found"]], _tie),
        _bar("found and named at strength 0.5", 0.77, at[0.5], _named),
        _bar("clean runs wrongly named", -0.02, clean, lambda r: bool(r["found"])),
        _bar("clean runs with any alarm", -0.05, clean, lambda r: r["verdict"] != "adequate"),
        _bar("outside the library said to be unknown at strength 1, a close relative of the lag left out", 0.9,
             [r for r in outside if r["hidden"][0] != "two_pole_lag"], _unknown),
        _bar("the same for periodic, (dT/dt)^2, etalon and unlogged drift alone", 0.9,
             [r for r in outside if r["hidden"][0] not in ("two_pole_lag", "emi")], _unknown),
        _bar("two effects of strength 1 at once, both found", 0.8, pairs, _both),
        _bar("weak ties after one ramp decided by the run that the bench proposes", 0.9, _tied(second),
             lambda r: _decided(r, "after")),
    ]  # fmt: skip
    ratios = [r["held_named"] / r["held_true"] for r in held]
    rows.append(_number("error on an unseen run over the true model's at strength 1, median", 1.05, ratios, 0.5))
    rows.append(_number("the same, 95 % of the cases", 1.05, ratios, 0.95))
    seconds = [r["processor_s"] for r in single if "processor_s" in r]
    rows.append(_number("processor time of a diagnosis, median [s]", 20.0, seconds, 0.5))
    return "## Bars\n" + _table(("", "bar", "measured", "95 % interval", "cases", "reached"), rows)


def _bar(words: str, bar: float, results: Sequence[Result], true: Callable[[Result], bool]) -> tuple[str, ...]:
    """A share with its interval (Wilson); a negative bar is a most, not a least."""
    asked = f"{'at least' if bar > 0 else 'at most'} {abs(100 * bar):.0f} %"
    if not results:
        return (words, asked, "–", "–", "0", "not measured")
    test = binomtest(sum(map(true, results)), len(results))
    low, high = test.proportion_ci(method="wilson")
    reached = test.statistic >= bar if bar > 0 else test.statistic <= -bar
    interval = f"{100 * low:.1f} to {100 * high:.1f} %"
    return (words, asked, f"{100 * test.statistic:.1f} %", interval, str(len(results)), "yes" if reached else "**no**")


def _number(words: str, most: float, values: Sequence[float], quantile: float) -> tuple[str, ...]:
    if not values:
        return (words, f"at most {most:g}", "–", "–", "0", "not measured")
    found = float(np.quantile(values, quantile))
    return (words, f"at most {most:g}", f"{found:.3g}", "–", str(len(values)), "yes" if found <= most else "**no**")


def _strengths(single: Sequence[Result], limits: dict[str, float]) -> str:
    head = ("strength", "cases", "anything found", "named", "first suspect", "first three or tie", "tie",
            *(f"{p.upper()} first" for p in _PEERS), *(f"{p.upper()} named" for p in _PEERS))  # fmt: skip
    rows = []
    for strength in sorted({r["strength"] for r in single}):
        own = [r for r in single if r["strength"] == strength]
        found = [r for r in own if r["found"]]
        first = [_share(own, lambda r, p=peer: _peer_first(r, p)) for peer in _PEERS]  # type: ignore[misc]
        named = [
            _share(own, lambda r, p=peer: _peer_first(r, p) and r[p]["score"] > limits[p])  # type: ignore[misc]
            for peer in _PEERS
        ]
        rows.append((f"{strength:g}", str(len(own)), _share(own, lambda r: bool(r["found"])), _share(own, _named),
                     _share(own, _first), _share(own, _in_three), _share(found, _tie), *first, *named))  # fmt: skip
    return _table(head, rows)


def _clean(clean: Sequence[Result]) -> str:
    rows = []
    for profile in sorted({r["profile"] for r in clean}):
        own = [r for r in clean if r["profile"] == profile]
        rows.append((profile, str(len(own)), _share(own, lambda r: bool(r["found"])),
                     _share(own, _unknown),
                     *(_share(own, lambda r, p=peer: r[p]["default"]) for peer in _PEERS)))  # type: ignore[misc] # fmt: skip
    return _table(("profile", "runs", "named", "unknown", "FROLS names, own rule", "STLSQ names, own rule"), rows)


def _effects(single: Sequence[Result]) -> str:
    strengths = sorted({r["strength"] for r in single})
    rows = []
    for name in dict.fromkeys(r["hidden"][0] for r in single):
        cells = []
        for strength in strengths:
            own = [r for r in single if r["hidden"] == [name] and r["strength"] == strength]
            cells.append(f"{_share(own, _named)} / {_share([r for r in own if r['found']], _tie)}")
        rows.append((name, *cells))
    return _table(("hidden", *(f"{s:g}" for s in strengths)), rows)


def _outside(single: Sequence[Result]) -> str:
    own = [r for r in single if HIDDEN[r["hidden"][0]].effect is None]
    strengths = sorted({r["strength"] for r in own})
    rows = []
    for name in dict.fromkeys(r["hidden"][0] for r in own):
        cells = []
        for strength in strengths:
            these = [r for r in own if r["hidden"] == [name] and r["strength"] == strength]
            wrong = sorted({r["found"][0] for r in these if r["found"] and r["verdict"] == "missing_effect"})
            said = _share(these, _unknown)
            cells.append(f"{said} (named {', '.join(wrong)})" if wrong else said)
        rows.append((name, *cells))
    return _table(("hidden", *(f"{s:g}" for s in strengths)), rows)


def _held_out(single: Sequence[Result]) -> str:
    keys = ("held_base", "held_named", "held_rival", "held_true")
    rows = []
    for strength in sorted({r["strength"] for r in single}):
        own = [r for r in single if r["strength"] == strength and _named(r)]
        medians = [[r[key] for r in own if r.get(key) is not None] for key in keys]
        helped = [r for r in own if r.get("held_rival") is not None]
        rows.append((f"{strength:g}", *(f"{np.median(m):.2f}" if m else "–" for m in medians),
                     _share(helped, lambda r: r["held_rival"] < r["held_base"])))  # fmt: skip
    head = ("strength", "model as it is", "+ named", "+ best rival", "+ true effect", "a wrong rival also helped")
    return _table(head, rows)


def _both(result: Result) -> bool:
    return _hidden_families(result) <= {_family(name) for name in result["found"]}


def _pairs(pairs: Sequence[Result]) -> str:
    rows = []
    for hidden in dict.fromkeys(tuple(r["hidden"]) for r in pairs):
        rows.append((" + ".join(hidden), *_pair_row([r for r in pairs if tuple(r["hidden"]) == hidden])))
    rows.append(("all", *_pair_row(pairs)))
    return _table(("hidden", "cases", "both found", "both and nothing else", "at least one"), rows)


def _pair_row(own: Sequence[Result]) -> tuple[str, ...]:
    def families(r: Result) -> set[str]:
        return {_family(name) for name in r["found"]}

    return (
        str(len(own)),
        _share(own, _both),
        _share(own, lambda r: _hidden_families(r) == families(r)),
        _share(own, lambda r: bool(_hidden_families(r) & families(r))),
    )


def _tied(second: Iterable[Result]) -> list[Result]:
    """Units that the first run leaves open and a second run was made of."""
    return [r for r in second if r["tied"] and "after" in r]


def _decided(result: Result, key: str) -> bool:
    return not result[key]["tied"] and _named({**result, **result[key]})


def _second(second: Sequence[Result]) -> str:
    rows = []
    for strength in sorted({r["strength"] for r in second}):
        own = [r for r in second if r["strength"] == strength]
        tied = _tied(own)
        alone = _share(own, lambda r: not r["tied"] and _named(r))
        proposed = _share(tied, lambda r: _decided(r, "after"))
        repeated = _share(tied, lambda r: _decided(r, "repeated"))
        rows.append((f"{strength:g}", str(len(own)), alone, str(len(tied)), proposed, repeated))
    head = ("strength", "units", "decided by the first run", "tied", "of these decided by the proposed run",
            "by the same run again")  # fmt: skip
    return _table(head, rows)
