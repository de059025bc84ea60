"""Sections about the run: facts, profile, measured bias, noise, losses and events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from markupsafe import Markup

from bench.analysis import LOST, Analysis, Completeness, branch_gap
from bench.base import capital, clock, counted, moment, number
from bench.deliver.report import figures_run
from bench.deliver.report.markup import Row, Section, facts, figure, heading, mono, paragraph, table, text_of
from bench.record import EVENTS, earth_told, read_events

_LOSS_WORDS: Mapping[str, str] = {
    "received": "received",
    "lost": "rate samples lost (gap in the unit's sample counter)",
    "slow_lost": "slow samples lost",
    "corrupt": "corrupt (CRC)",
    "repeated": "repeated",
    "late": "late",
    "out_of_order": "out of order",
    "resets": "restarts of the unit",
    "invalid": "left out: no measurements",
    "journal_damaged_bytes": "bytes of the journal damaged",
}
_QUIET_EVENTS = frozenset({"segment", "settled", "write"})


def profile(analysis: Analysis) -> Section | None:
    """The profile as it was executed."""
    if analysis.dataset is None:
        return None
    done = analysis.done
    low, high = done.temperature or (float("nan"), float("nan"))
    failed = [(segment.from_s, segment.to_s) for segment in done.failed]
    words = (
        f"The unit went from {number(low)} to {number(high)} °C in {clock(done.duration_s)} h: {clock(done.heating_s)} "
        f"heating, {clock(done.cooling_s)} cooling."
    )
    caption = "Temperatures over time. Shaded: segments that failed." if failed else "Temperatures over time."
    plot = figures_run.profile_figure(analysis.dataset, failed)
    return Section("profile", "Profile followed", paragraph(words) + figure("fig-profile", plot, caption, words))


def bias(analysis: Analysis) -> Section | None:
    """Bias over temperature, its loop coloured by time, and the other channels."""
    data = analysis.dataset
    if data is None:
        return None
    words = f"The bias changes by {number(analysis.bias_span_dph)} deg/h over the run."
    gap = branch_gap(data)
    if gap is not None:
        words += f" Heating and cooling differ by up to {number(abs(gap[0]))} deg/h, at {gap[1]:.0f} °C."
    caption = (
        f"Bias over temperature, means over {analysis.interval_s:g} s, coloured by time; arrows show the direction. "
        "Where heating and cooling differ, a function of temperature alone cannot describe the bias."
    )
    alt = f"Loop of the zero-rate output over the temperature of the unit. {words}"
    html = paragraph(words) + figure("fig-loop", figures_run.loop_figure(data), caption, alt)
    others = figures_run.channels_figure(data)
    if others is not None:
        caption = "Other channels of unit and instruments over temperature, which models of several channels can use."
        html += figure("fig-channels", others, caption, "Other channels of unit and instruments over temperature")
    return Section("bias", "Bias over temperature", html)


def noise(analysis: Analysis) -> Section | None:
    """Allan deviation of the soaks, and the noise coefficients that give the floor."""
    if analysis.dataset is None:
        return None
    floor = analysis.floor
    if floor.noise is None:
        return Section("noise", "Noise floor", paragraph(f"Unknown: {floor.reason}."))
    noise_found = floor.noise
    rows = []
    names = (
        ("N", "angle random walk", "white", "deg/√h"),
        ("B", "bias instability", "flicker", "deg/h"),
        ("K", "rate random walk", "walk", "deg/h/√h"),
        *(("M", f"correlated noise, {tau_s:.2g} s", "correlated", "deg/h") for tau_s in noise_found.times_s),
    )
    for letter, meaning, name, unit in names:
        low, high = noise_found.intervals.get(name, (float("nan"), float("nan")))
        value = f"below {number(high, 2)}" if name in noise_found.undetermined else number(getattr(noise_found, name))
        rows.append((letter, meaning, value, f"{number(low)} to {number(high)}", unit))
    spans = f"{counted(len(floor.stretches), 'isothermal span')}{f' of the run {floor.static}' if floor.static else ''}"
    words = (
        f"Means over {analysis.interval_s:g} s of a run this long scatter by {number(floor.floor_dph)} deg/h "
        f"({number(floor.interval_dph[0])} to {number(floor.interval_dph[1])}) about their own mean from noise alone: "
        "N, and B and K where the data tell them from zero; the interval (95 %) also has what they could be otherwise. "
        f"This noise floor was estimated from {spans}. A model that follows slow noise of this run can leave less."
    )
    alt = "Allan deviation over averaging time. " + "; ".join(f"{row[0]}: {row[2]} {row[4]}" for row in rows)
    caption = (
        "Overlapping Allan deviation of each soak; dashed: the noise estimated from all soaks together by maximum "
        "likelihood (N also from the samples within each second), slow thermal tails removed (they still show in the "
        "curves at long times)."
    )
    head = ("coefficient", "", "value", "95 % interval", "unit")
    html = paragraph(words) + table("Noise coefficients (IEEE Std 952)", head, rows, (2, 3))
    html += Markup().join(paragraph(f"{capital(note)}.") for note in floor.notes)
    html += figure("fig-allan", figures_run.allan_figure(floor.curves, noise_found), caption, alt)
    return Section("noise", "Noise floor", html)


def losses(analysis: Analysis) -> Section:
    """Frames lost, samples missing, segments with their outcome, events."""
    done = analysis.done
    html = heading("Frames and samples")
    if done.losses:
        rows = (
            Row((_LOSS_WORDS.get(key, key), f"{count:,}"), "bad" if key in LOST and count else "")
            for key, count in done.losses.items()
        )
        html += table("Frames, counted by the unit's sample counter and CRC", ("frames", "count"), rows, (1,))
    else:
        html += paragraph("The source of this record did not count its frames.")
    share = "" if done.unplanned is None else f"; {done.unplanned:,} missing between the first and the last"
    html += paragraph(f"{done.samples:,} rate samples{share}; gaps of more than a second: {len(done.gaps_s)}.")
    html += Markup("").join(paragraph(text) for text in _clocks(done))
    if done.gaps_s:
        gaps = [Row((clock(a), clock(b), number(b - a)), "bad") for a, b in done.gaps_s]
        html += table("Gaps, which are not filled", ("from", "to", "length [s]"), gaps, (0, 1, 2))
    if done.segments:
        html += heading("Segments") + _segments(analysis)
    events = list(_events(analysis))
    if events:
        html += heading("Events") + table("Events in order of time", ("time", "kind", "what"), events, (0,))
    return Section("losses", "Losses and events", html)


def _clocks(done: Completeness) -> Iterator[str]:
    """The unit's clock relative to the host's, and the longest delay of frames before capture."""
    if done.unit_clock is not None:
        drift, uncertainty, spread = (
            done.unit_clock.drift_ppm, done.unit_clock.drift_u_ppm, done.unit_clock.spread_s
        )  # fmt: skip
        known = (
            "the record is too short for its uncertainty"
            if uncertainty is None
            else f"± {2 * uncertainty:.2g} ppm, k = 2"
        )
        near = "" if spread is None else f"; the fastest frames lie within {1e3 * spread:.3g} ms of that line"
        yield (
            f"Samples are timed by the unit's counter; its clock runs {abs(drift):.4g} ppm "
            f"{'slower' if drift >= 0 else 'faster'} than the host's clock ({known}){near}."
        )
    if done.capture is not None:
        yield f"No frame waited longer than {done.capture.most_behind_s:.3f} s for the capture."


def _segments(analysis: Analysis) -> Markup:
    ratios = {}
    if analysis.best is not None:
        ratios = {s.name: s for s in analysis.best.segments if s.run == _name(analysis)}
    rows = []
    for segment in analysis.done.segments:
        score = ratios.get(segment.name)
        failed = segment in analysis.done.failed
        reason = f" ({segment.reason})" if segment.reason else ""
        cells = (
            segment.name, segment.kind, segment.direction, clock(segment.from_s), clock(segment.to_s),
            number(_float(segment.target_degc)), number(_float(segment.rate_degc_per_min)),
            f"{'FAILED: ' if failed else ''}{segment.outcome}{reason}",
            number(score.rms_dph if score else None), number(score.floor_ratio if score else None, 2),
        )  # fmt: skip
        rows.append(Row(cells, "bad" if failed else ""))
    head = (
        "segment", "kind", "direction", "from", "to", "target [°C]", "rate [°C/min]", "outcome", "residual RMS [deg/h]",
        "× floor",
    )  # fmt: skip
    return table("All segments; the residual is that of the best model", head, rows, (3, 4, 5, 6, 8, 9))


def _name(analysis: Analysis) -> str:
    return analysis.dataset.name if analysis.dataset is not None else ""


def _events(analysis: Analysis) -> Iterator[Row]:
    events = read_events(analysis.run.path / EVENTS)
    for event in events.sound:
        if event.get("kind") not in _QUIET_EVENTS:
            bad = event.get("kind") in {"guard", "link"} or event.get("ok") is False
            cells = (clock(_float(event.get("t_s"))), event.get("kind", ""), event.get("text", ""))
            yield Row(cells, "bad" if bad else "")
    if events.damaged:
        yield Row(("–", "report", f"{EVENTS}: {events.damaged} damaged line(s) skipped"), "bad")


def _float(value: Any) -> float:
    return float("nan") if value is None else float(value)


def run_facts(analysis: Analysis) -> Section:
    """Unit, profile, station, time and versions of the run, and hashes of its data."""
    manifest, done = analysis.manifest, analysis.done
    pairs: list[tuple[str, object]] = [
        ("unit", manifest.unit or "–"),
        ("run", manifest.run or "–"),
        ("profile", manifest.profile or "–"),
        (
            "station",
            "simulated" if manifest.simulated else manifest.station or "see station.yaml in the run folder",
        ),
        ("started", moment(manifest.created or "–")),
        ("ended", f"{done.state}{f': {done.cause}' if done.cause else ''}"),
        ("duration [h:mm:ss]", clock(done.duration_s)),
        ("samples", f"{done.samples:,} at {manifest.sample_rate_hz or '–'} Hz"),
        ("averaging for all fits [s]", f"{analysis.interval_s:g}"),
        ("orientation", earth_told(manifest.orientation)),
        ("versions", text_of(manifest.versions or "–")),
    ]
    if manifest.companions:
        pairs.append(("in the same chamber", ", ".join(companion.unit for companion in manifest.companions)))
    if manifest.seeds:
        pairs.append(("seeds of the simulation", text_of(manifest.seeds)))
    html = facts(pairs, "The run")
    if manifest.files:
        rows = ((name, mono(digest)) for name, digest in manifest.files.items())
        html += table("SHA-256 of the recorded files", ("file", "SHA-256"), rows)
    return Section("facts", "Run facts", html)
