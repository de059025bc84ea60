"""The page of a fleet: one HTML file, made of the same pieces as the report of a run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bench.archive.fleet import figures
from bench.archive.fleet.drift import SIGNIFICANT
from bench.archive.fleet.shifts import Shift
from bench.archive.fleet.statistics import Measured, Statistics
from bench.base import counted, in_print, listed, moment, number
from bench.deliver import Headline, Row, Section, figure, heading, html_page, lead, paragraph, table

GOOD_CPK = 1.33
"""Four sigma between the mean and the nearer limit: the usual least capability of a process."""


_VERBS = {"station": ("drifts", "drift"), "lot": ("differs", "differ")}


@dataclass(frozen=True)
class _Word:
    tone: str
    headline: str
    sentence: str


def render(found: Statistics) -> str:
    """The page as HTML text."""
    sections = [*_yields(found), _capability(found), _drift(found), _shifts(found), _unlike(found), *_charts(found)]
    newest = found.fleet.newest
    return html_page(
        sections,
        title=f"Fleet of {counted(len(newest), 'unit')}",
        subtitle=f"{moment(newest[0].created)} to {moment(newest[-1].created)}",
        verdict=_verdict(found),
        numbers=_numbers(found),
        warnings=(),
        source="the registry",
    )


def sentence(found: Statistics) -> str:
    """What needs attention, or that nothing does."""
    parts = []
    if bad := found.passes.outside:
        parts.append(f"{bad} of {found.passes.judged} judged units are outside their limits")
    if unknown := found.passes.unjudged:
        why = f" (no unit has {listed(list(found.missing))})" if found.missing else ""
        parts.append(f"{unknown} of {len(found.fleet.words)} units are not judged: their runs are INVALID{why}")
    if later := found.fleet.later:
        runs = listed([f"{one.unit} ({moment(one.created)})" for one in later[-5:]])
        parts.append(f"{runs}{' and others' if len(later) > 5 else ''}: the newest run is not judged, and the judged "
                     "run before it counts")  # fmt: skip
    for kind in ("station", "lot"):
        if places := found.drifted(kind):
            parts.append(f"{kind} {listed(places)} {_VERBS[kind][len(places) > 1]}")
    parts += [said(one, found) for one in found.shifts]
    if found.odd:
        serials = [found.fleet.newest[one.row].unit for one in found.odd]
        parts.append(f"{listed(serials[:5])}{' and others' if len(serials) > 5 else ''} unlike their lot")
    if found.beyond:
        parts.append(f"units beyond three sigma in {listed(found.beyond)}")
    if found.silent:
        return "There are too few units: none was judged against limits, and no quantity has a chart."
    if not parts and not found.charted:
        return "No judged unit is outside its limits; there are too few for a chart."
    text = "; ".join(parts) or "nothing needs attention: no drift, no shift, no odd unit, no value beyond three sigma"
    return f"{text[0].upper()}{text[1:]}."


def said(one: Shift, found: Statistics) -> str:
    """A shift in words."""
    unit, since = in_print(found.fleet.units[one.quantity]), found.fleet.newest[one.since]
    return (
        f"station {one.place} has shifted by {one.change:+.3g}{f' {unit}' if unit else ''} in {one.quantity} since "
        f"{since.unit} ({moment(since.created)})"
    )


def _verdict(found: Statistics) -> _Word:
    if found.passes.outside:
        return _Word("bad", "Units outside their limits", sentence(found))
    if found.silent:
        return _Word("warn", "Cannot tell yet", sentence(found))
    good = _Word("good", "In control" if found.charted else "Within limits", sentence(found))
    return good if found.quiet else _Word("warn", "Look at this", sentence(found))


def _numbers(found: Statistics) -> Iterable[Headline]:
    passes = found.passes
    if passes.judged:
        low, high = passes.interval
        more = f"{passes.first} of {passes.judged} at the first attempt, {passes.final} with their newest judged run; "
        more += f"95 %: {100 * low:.1f} to {100 * high:.1f} %"
        yield Headline("first-pass yield", f"{100 * passes.first / passes.judged:.1f}", "%", more)
    able = [one for one in found.measured if one.capability and np.isfinite(one.capability.cpk)]
    if able:
        worst = min(able, key=lambda one: one.capability.cpk if one.capability else np.inf)
        yield Headline("least Cpk", number(worst.capability.cpk, 3) if worst.capability else "–", "", worst.name)
    yield Headline("units", str(len(found.fleet.newest)), "",
                   f"{len({one.lot for one in found.fleet.newest})} lots, "
                   f"{len({one.station for one in found.fleet.newest})} stations")  # fmt: skip


def _yields(found: Statistics) -> Iterable[Section]:
    if found.passes.judged:
        caption = "First-pass yield over the days of the units' first judged runs (UTC), with 95 % of it."
        yield Section("yield", "Yield over time", figure("yield", figures.yields(*found.attempts), caption, caption))


def _capability(found: Statistics) -> Section:
    limited = [one for one in found.measured if one.capability is not None]
    if not limited:
        text = "Capability needs limits (--limits FILE) and at least eight units."
        return Section("capability", "Capability", paragraph(text))
    rows = [_capability_row(one) for one in limited]
    head = ("quantity", "unit", "units", "lower", "upper", "mean", "Cpk", "95 %", "Ppk", "95 %", "outside", "values")
    html = table("Capability against the limits", head, rows, range(2, 11))
    note = (
        "Cpk uses the spread of neighbours in time, Ppk the spread of all units: where Ppk is much lower, the process "
        "moves. Values that are not normal are transformed first; where that does not help, Ppk is that of the share "
        f"outside, and there is no Cpk. Lines below {GOOD_CPK:g} are marked."
    )
    return Section("capability", "Capability", html + paragraph(note))


def _capability_row(one: Measured) -> Row:
    able = one.capability
    if able is None:
        raise RuntimeError("a row needs a capability")
    intervals = [f"{number(low, 3)} to {number(high, 3)}" for low, high in (able.cpk_interval, able.ppk_interval)]
    cells = (one.name, in_print(one.unit), able.count, number(one.lower), number(one.upper), number(able.mean),
             number(able.cpk), intervals[0], number(able.ppk), intervals[1], able.outside, able.shape)  # fmt: skip
    return Row(cells, "bad" if able.ppk < GOOD_CPK else "")


def _drift(found: Statistics) -> Section:
    moved = found.moved
    tested = f"{len(found.drifts)} changes were tested; the table has those with p < {SIGNIFICANT:g} after Holm."
    if not found.drifts:
        few = "Too few units to test: a station needs eight, and two lots need three each."
        return Section("drift", "Drift of stations and lots", lead(few))
    if not moved:
        return Section(
            "drift", "Drift of stations and lots", lead("No station drifts, and no lot differs.") + paragraph(tested)
        )
    rows = [
        (f"{one.kind} {one.place}", one.quantity, number(one.change), number(one.error, 2),
         in_print(found.fleet.units[one.quantity]) + (" a day" if one.kind == "station" else ""), f"{one.p:.1e}",
         one.count, number(one.ewma, 2))
        for one in moved
    ]  # fmt: skip
    head = ("place", "quantity", "change", "±", "unit", "p", "units", "EWMA")
    html = table("Changes that chance does not explain", head, rows, (2, 3, 5, 6, 7))
    note = (
        "A station's change is its slope within lots; a lot's is its mean against the others at the same station. EWMA "
        "is the weighted mean of a station's latest units in units of its limit: beyond ±1 it has left its level now. "
    )
    return Section("drift", "Drift of stations and lots", html + paragraph(note + tested))


def _shifts(found: Statistics) -> Section:
    limits = listed([f"{one.kind.upper()} {one.limit:.3g} σ" for one in found.charts])
    note = (
        f"A CUSUM and an EWMA of each station and quantity, each value beside all earlier ones of its station and "
        f"without the level of its lot. Their limits ({limits}) are for so many values: of fleets without a change, "
        f"{100 * SIGNIFICANT:g} % have an alarm; each chart of a station has one in {found.charts[0].run_length:,.0f} "
        "values."
    )
    if not found.shifts:
        return Section("shifts", "Shifts of stations", lead("No station has left its level.") + paragraph(note))
    rows = [
        (one.place, one.quantity, number(one.change), in_print(found.fleet.units[one.quantity]), one.chart.upper(),
         found.fleet.newest[one.since].unit, moment(found.fleet.newest[one.since].created),
         found.fleet.newest[one.row].unit, one.before, one.count)
        for one in found.shifts
    ]  # fmt: skip
    head = ("station", "quantity", "change", "unit", "chart", "since", "on", "found at", "units before", "units since")
    return Section("shifts", "Shifts of stations",
                   table("Stations that left their level", head, rows, (2, 8, 9)) + paragraph(note))  # fmt: skip


def _unlike(found: Statistics) -> Section:
    fleet = found.fleet
    if not np.any(np.isfinite(found.distances)):
        return Section(
            "unlike", "Units unlike their lot", paragraph("Twelve units with the same quantities are needed.")
        )
    rows = [
        (fleet.newest[one.row].unit, fleet.newest[one.row].lot, number(one.distance), f"{one.p:.1e}", one.quantity,
         f"{one.sigmas:+.1f} σ")
        for one in found.odd
    ]  # fmt: skip
    head = ("unit", "lot", "distance", "p", "leading quantity", "from the lot's median")
    html = table("Units unlike their lot", head, rows, (2, 3, 5)) if rows else lead("Every unit is like its lot.")
    caption = f"Robust distance over all quantities at once, each against the median of its lot.{_newest(found)}"
    drawn = figure("distances", figures.of_lots(found), caption, caption)
    return Section("unlike", "Units unlike their lot", html + drawn)


def _newest(found: Statistics) -> str:
    many = len(found.fleet.newest)
    return f" The newest {figures.MOST} of {many} units." if many > figures.MOST else ""


def _charts(found: Statistics) -> Iterable[Section]:
    html = Markup("")
    for one in found.measured:
        if one.chart is None:
            continue
        said = [f"{found.fleet.newest[one.rows[s.index]].unit}: {s.text} (rule {s.rule})" for s in one.chart.signals]
        caption = "; ".join(said[:12]) + (f"; and {len(said) - 12} more" if len(said) > 12 else "")
        stations = [found.fleet.newest[row].station for row in one.rows[-figures.MOST :]]
        drawn = figures.control(one.chart.newest(figures.MOST), one.name, one.unit, (one.lower, one.upper), stations)
        alt = f"Control chart of {one.name} over {one.values.size} units, {len(said)} signals"
        html += heading(one.name) + figure(f"chart-{one.name}", drawn, caption or "No rule is broken.", alt)
    if html:
        rules = "Individual values and moving ranges; sigma from neighbours; the eight rules of Nelson (1984)."
        yield Section("charts", "Control charts", paragraph(rules) + html)
