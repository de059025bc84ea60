"""The table of the campaign, from its cached results: docs/hidden_effects.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from bench.mystery.hidden import HIDDEN
from benchmarks.bars import bars, table
from benchmarks.peers import STLSQ_THRESHOLDS
from benchmarks.scores import (
    Result,
    both,
    decided,
    family,
    first,
    hidden_families,
    in_three,
    inside,
    named,
    tie,
    tied,
    unknown,
)

_PEERS = ("frols", "stlsq")
_LEVEL = 0.95  # of clean runs below a peer's threshold

_HEAD = """# Hidden effects: how often the bench names them

Written by `python -m benchmarks.hidden_effects`; {cases} cases, {seeds} seeds. Every case is a simulated unit whose
truth integrates separate states and shares no formula with the analysis. The model diagnosed is a static spline with
8 intervals; beside the run there is an isothermal run of three hours. Noise: 0.01 deg/sqrt(h), 0.03 deg/h, 0.03
deg/h/sqrt(h).

*Strength* is the RMS of the part of the effect that the static spline cannot absorb, divided by the RMS of the noise.
*Named* is found and right: the first of the effects found belongs to the hidden family. *Tie* counts the truth among
the effects found or their declared look-alikes, of the cases in which anything was found. The isothermal run is one in
which the hidden effect is not excited.

Cases: {kinds}.
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
    alone = Counter(f"{r['profile']} at {r['strength']:g}" for r in single)
    kinds = ", ".join([*(f"{n} on {where}" for where, n in sorted(alone.items())), f"{len(clean)} with nothing hidden"])
    parts = [_HEAD.format(cases=len(results), seeds=seeds, kinds=kinds)]
    parts.append(bars(results))
    parts.append("## All effects of the library together\n" + _strengths(inside(single), limits))
    if any(_with(clean, peer) for peer in _PEERS):
        shown = {peer: f"{limits[peer]:.3g}" for peer in _PEERS}
        parts.append(_PEERS_NOTE.format(thresholds=", ".join(f"{t:g}" for t in STLSQ_THRESHOLDS), **shown))
    else:
        parts.append("The peers were not run: their packages (extra `peers`) were not installed.")
    parts.append("## Nothing hidden\n" + _clean(clean))
    for profile in dict.fromkeys(r["profile"] for r in single):
        own = [r for r in single if r["profile"] == profile]
        parts.append(f"## Effect by effect, profile `{profile}`: named / tie holds the truth\n" + _effects(inside(own)))
        parts.append(f"## Outside the library, profile `{profile}`: `unknown` reported\n" + _outside(own))
    parts.append("## Error on a run that no fit saw, over its noise (median)\n" + _held_out(inside(single)))
    parts.append("## Two effects at once, strength 1 each\n" + _pairs([r for r in results if r["kind"] == "pair"]))
    parts.append(
        "## The second run, after one ramp at one rate\n" + _second([r for r in results if r["kind"] == "second"])
    )
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def _peer_first(result: Result, peer: str) -> bool:
    ranking = result[peer]["ranking"]
    return bool(ranking) and family(ranking[0]) in hidden_families(result)


def _limit(clean: Sequence[Result], peer: str) -> float:
    scores = [r[peer]["score"] for r in _with(clean, peer)]
    return float(np.quantile(scores, _LEVEL)) if scores else float("nan")


def _with(results: Sequence[Result], peer: str) -> list[Result]:
    return [r for r in results if peer in r]


def _share(results: Sequence[Result], true: Callable[[Result], bool]) -> str:
    if not results:
        return "–"
    return f"{100.0 * sum(map(true, results)) / len(results):.0f} %"


def _strengths(single: Sequence[Result], limits: dict[str, float]) -> str:
    head = ("strength", "cases", "anything found", "named", "first suspect", "first three or tie", "tie",
            *(f"{p.upper()} first" for p in _PEERS), *(f"{p.upper()} named" for p in _PEERS))  # fmt: skip
    rows = []
    for strength in sorted({r["strength"] for r in single}):
        own = [r for r in single if r["strength"] == strength]
        found = [r for r in own if r["found"]]
        peers_first = [_share(_with(own, peer), lambda r, p=peer: _peer_first(r, p)) for peer in _PEERS]  # type: ignore[misc]
        peers_named = [
            _share(_with(own, peer), lambda r, p=peer: _peer_first(r, p) and r[p]["score"] > limits[p])  # type: ignore[misc]
            for peer in _PEERS
        ]
        rows.append((f"{strength:g}", str(len(own)), _share(own, lambda r: bool(r["found"])), _share(own, named),
                     _share(own, first), _share(own, in_three), _share(found, tie),
                     *peers_first, *peers_named))  # fmt: skip
    return table(head, rows)


def _clean(clean: Sequence[Result]) -> str:
    rows = []
    for profile in sorted({r["profile"] for r in clean}):
        own = [r for r in clean if r["profile"] == profile]
        rows.append((profile, str(len(own)), _share(own, lambda r: bool(r["found"])),
                     _share(own, unknown),
                     *(_share(_with(own, peer), lambda r, p=peer: r[p]["default"]) for peer in _PEERS)))  # type: ignore[misc] # fmt: skip
    return table(("profile", "runs", "named", "unknown", "FROLS names, own rule", "STLSQ names, own rule"), rows)


def _effects(single: Sequence[Result]) -> str:
    strengths = sorted({r["strength"] for r in single})
    rows = []
    for name in dict.fromkeys(r["hidden"][0] for r in single):
        cells = []
        for strength in strengths:
            own = [r for r in single if r["hidden"] == [name] and r["strength"] == strength]
            cells.append(f"{_share(own, named)} / {_share([r for r in own if r['found']], tie)}")
        rows.append((name, *cells))
    return table(("hidden", *(f"{s:g}" for s in strengths)), rows)


def _outside(single: Sequence[Result]) -> str:
    own = [r for r in single if HIDDEN[r["hidden"][0]].effect is None]
    strengths = sorted({r["strength"] for r in own})
    rows = []
    for name in dict.fromkeys(r["hidden"][0] for r in own):
        cells = []
        for strength in strengths:
            these = [r for r in own if r["hidden"] == [name] and r["strength"] == strength]
            wrong = sorted({r["found"][0] for r in these if r["found"] and r["verdict"] == "missing_effect"})
            share = _share(these, unknown)
            cells.append(f"{share} (named {', '.join(wrong)})" if wrong else share)
        rows.append((name, *cells))
    return table(("hidden", *(f"{s:g}" for s in strengths)), rows)


def _held_out(single: Sequence[Result]) -> str:
    keys = ("held_base", "held_named", "held_rival", "held_true")
    rows = []
    for strength in sorted({r["strength"] for r in single}):
        own = [r for r in single if r["strength"] == strength and named(r)]
        medians = [[r[key] for r in own if r.get(key) is not None] for key in keys]
        helped = [r for r in own if r.get("held_rival") is not None]
        rows.append((f"{strength:g}", *(f"{np.median(m):.2f}" if m else "–" for m in medians),
                     _share(helped, lambda r: r["held_rival"] < r["held_base"])))  # fmt: skip
    head = ("strength", "model as it is", "+ named", "+ best rival", "+ true effect", "a wrong rival also helped")
    return table(head, rows)


def _pairs(pairs: Sequence[Result]) -> str:
    rows = []
    for hidden in dict.fromkeys(tuple(r["hidden"]) for r in pairs):
        rows.append((" + ".join(hidden), *_pair_row([r for r in pairs if tuple(r["hidden"]) == hidden])))
    rows.append(("all", *_pair_row(pairs)))
    return table(("hidden", "cases", "both found", "both and nothing else", "at least one"), rows)


def _pair_row(own: Sequence[Result]) -> tuple[str, ...]:
    def families(r: Result) -> set[str]:
        return {family(name) for name in r["found"]}

    return (
        str(len(own)),
        _share(own, both),
        _share(own, lambda r: hidden_families(r) == families(r)),
        _share(own, lambda r: bool(hidden_families(r) & families(r))),
    )


def _second(second: Sequence[Result]) -> str:
    rows = []
    for strength in sorted({r["strength"] for r in second}):
        own = [r for r in second if r["strength"] == strength]
        open_ = tied(own)
        alone = _share(own, lambda r: not r["tied"] and named(r))
        proposed = _share(open_, lambda r: decided(r, "after"))
        repeated = _share(open_, lambda r: decided(r, "repeated"))
        rows.append((f"{strength:g}", str(len(own)), alone, str(len(open_)), proposed, repeated))
    head = ("strength", "units", "decided by the first run", "tied", "of these decided by the proposed run",
            "by the same run again")  # fmt: skip
    return table(head, rows)
