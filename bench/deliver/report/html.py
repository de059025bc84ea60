"""The HTML report of a run: one file that includes its scripts and styles and works offline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from bench.analysis import Analysis, standing
from bench.base import __version__, clock, moment, number
from bench.deliver.report import sections_diagnosis, sections_limits, sections_model, sections_run, sections_surface
from bench.deliver.report.markup import Section
from bench.record import CalibrationRecord, Manifest, put

_ASSETS = files("bench.deliver.report") / "assets"

SECTIONS: tuple[Callable[[Analysis], Section | None], ...] = (
    sections_limits.limits,
    sections_run.profile,
    sections_run.bias,
    sections_model.ladder,
    sections_diagnosis.missing,
    sections_model.compensation,
    sections_model.spline,
    sections_surface.surface,
    sections_model.residual,
    sections_run.noise,
    sections_model.coefficients,
    sections_run.losses,
    sections_run.run_facts,
    sections_model.terms,
)
"""The report from top to bottom; a section without content returns None."""

SIMULATED = "Unit, chamber and sensors of this run are simulated. This report says nothing about a real unit."
"""Banner of a report about a simulated run."""


@dataclass(frozen=True)
class Headline:
    """One of the numbers at the top."""

    what: str
    value: str
    unit: str
    more: str


def render(analysis: Analysis) -> str:
    """The report as HTML text."""
    sections = [section for make in SECTIONS if (section := make(analysis)) is not None]
    manifest = analysis.manifest
    when = (manifest.profile or "no profile", moment(manifest.created or "no date"))
    return html_page(
        sections,
        title=f"Thermal calibration of {manifest.unit or 'an unnamed unit'}",
        subtitle=", ".join((*map(str, when), f"{clock(analysis.done.duration_s)} h")),
        banner=SIMULATED if manifest.simulated else "",
        verdict=analysis.verdict,
        numbers=headlines(analysis),
        warnings=analysis.warnings,
        source=f"run folder {manifest.run or analysis.run.path.name}",
    )


def html_page(sections: Sequence[Section], **content: Any) -> str:
    """One HTML file of sections; `content`: title, subtitle, verdict, numbers, warnings and source of the template.

    A `banner` stands above all of it.
    """
    drawn = any("data-figure" in section.html for section in sections)
    environment = Environment(undefined=StrictUndefined, autoescape=True)
    return environment.from_string(_asset("report.html.j2")).render(
        **{"banner": "", **content},
        sections=sections,
        version=__version__,
        css=Markup(_asset("report.css")),
        plotly=Markup(get_plotlyjs()) if drawn else "",
        js=Markup(_asset("report.js")),
    )


def write_report(analysis: Analysis) -> Path:
    """Write report.html into the run folder, atomically; returns its path."""
    path = analysis.run.report
    put(path.parent, {path.name: render(analysis).encode()}, [Manifest.FILE, CalibrationRecord.FILE])
    return path


def headlines(analysis: Analysis) -> tuple[Headline, ...]:
    """The three main numbers; empty if nothing was captured."""
    if analysis.dataset is None:
        return ()
    best, floor_dph = analysis.best, analysis.floor.floor_dph
    numbers = []
    if best is not None:
        proven = bool(np.isfinite(best.held_out.rms_dph))
        ratio = f", {number(analysis.held_out_ratio, 2)} × the floor" if np.isfinite(analysis.held_out_ratio) else ""
        what = "model error on unseen data" if proven else "model error, in-sample only"
        more = f"RMS of {best.model.name}{ratio}; {number(best.rms_dph)} deg/h in-sample"
        numbers.append(Headline(what, number(best.held_out.rms_dph if proven else best.rms_dph), "deg/h", more))
    known = bool(np.isfinite(floor_dph))
    source = "from the isothermal run" if analysis.floor.static else "from the soaks of the run"
    more = f"of {analysis.interval_s:g} s means, {source}" if known else "unknown: no usable soak"
    numbers.append(Headline("noise floor", number(floor_dph), "deg/h", more))
    turned = len(standing(analysis.dataset)) < len(analysis.dataset)
    more = f"highest minus lowest; {number(analysis.uncompensated_dph)} deg/h RMS uncompensated"
    if turned:  # while a table turns, the error of the scale factor is no bias
        more = "highest minus lowest, while the rate table stands still"
    elif np.isfinite(analysis.improvement):
        more += f", {number(analysis.improvement, 2)} × the error after compensation"
    numbers.append(Headline("bias over the run", number(analysis.bias_span_dph), "deg/h", more))
    return tuple(numbers)


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")
