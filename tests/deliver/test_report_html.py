"""The HTML report: one file, no network, every figure with units, hostile names harmless."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from bench.analysis.diagnosis.sentences import sentence
from bench.analysis.effects.model import load_model
from bench.analysis.judging.analysis import Analysis
from bench.analysis.judging.diagnosed import Diagnosed
from bench.analysis.judging.judge import analyse
from bench.base.digits import in_print, moment, number, with_uncertainty
from bench.deliver.report import plotting
from bench.deliver.report.html import render, write_report
from bench.deliver.report.markup import figure
from tests.support.report_runs import clean, disturbed, looped, quick
from tests.support.run_folders import keep, make_run, ramp_run

FIGURES = {
    "profile", "loop", "channels", "ladder", "compensation", "spline", "residual-temperature", "residual-time", "allan",
} | {"missing-ladder", "missing-map", "missing-hysteresis", "missing-legs", "missing-detectable"}  # fmt: skip
NAMED_AXES = {
    (f"fig-{name}-data", "yaxis") for name in ("ladder", "missing-ladder", "missing-legs", "missing-detectable")
}
"""Axes of names, without a unit."""
HOSTILE = '</script><script>alert("x")</script><img src=//evil.example/x onerror=alert(1)>'
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


class Page(HTMLParser):
    """Tags with attributes, contents of scripts, and the text of everything else."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == "script":
            self.scripts[-1] += data
        elif self.cdata_elem is None:
            self.text += data

    def figures(self) -> dict[str, dict[str, Any]]:
        ids = [a["id"] for tag, a in self.tags if tag == "script" and a.get("type") == "application/json"]
        bodies = [body for body in self.scripts if body.startswith('{"data"')]
        return {str(name): json.loads(body) for name, body in zip(ids, bodies, strict=True)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    return looped(tmp_path_factory.getbasetemp())


@pytest.fixture(scope="module")
def page(whole: Analysis) -> Page:
    return Page(render(whole))


@pytest.mark.slow
def test_the_page_asks_no_network_for_anything(page: Page) -> None:
    for tag, attributes in page.tags:
        assert tag not in {"link", "iframe", "img", "object", "embed", "base", "form"}
        assert "src" not in attributes
        assert attributes.get("href", "#").startswith("#")
    (policy,) = [a["content"] for tag, a in page.tags if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy


def test_every_figure_is_there_with_units_on_all_axes_and_words_for_whoever_cannot_see_it(page: Page) -> None:
    assert {name.removeprefix("fig-").removesuffix("-data") for name in page.figures()} == FIGURES
    for name, plot in page.figures().items():
        axes = {key: value for key, value in plot["layout"].items() if re.fullmatch(r"[xy]axis\d*", key)}
        assert axes
        for key, axis in axes.items():
            title = axis["title"]["text"]
            assert re.search(r"\[.+\]", title) or (name, key) in NAMED_AXES, (name, key, title)
    labels = [a for tag, a in page.tags if tag == "div" and a.get("class") == "plot"]
    assert len(labels) == len(FIGURES)
    assert all(len(a["aria-label"] or "") > 20 for a in labels)


def test_verdict_and_three_numbers_stand_before_everything_else(page: Page, whole: Analysis) -> None:
    top = page.text[: page.text.index("Profile followed")]
    assert whole.verdict.headline in top
    assert whole.verdict.sentence in top
    assert whole.best is not None
    for value in (whole.best.held_out.rms_dph, whole.floor.floor_dph, whole.bias_span_dph):
        assert number(value) in top
    assert page.text.index("Complete, no frame lost") < page.text.index("noise floor")


def test_tables_are_tables_and_headings_are_linked(page: Page) -> None:
    targets = {a["href"] for tag, a in page.tags if tag == "a"}
    headings = {f"#{a['id']}" for tag, a in page.tags if tag == "h2"}
    assert targets == headings
    assert all("scope" in a for tag, a in page.tags if tag == "th")
    tables, heads = (sum(tag == name for tag, _ in page.tags) for name in ("table", "thead"))
    assert tables >= 6
    assert heads == tables - 1  # the facts have no heading


def test_the_ladder_table_holds_the_numbers_of_the_comparison(page: Page, whole: Analysis) -> None:
    assert whole.comparison is not None
    for score in whole.comparison.scores:
        assert number(score.rms_dph) in page.text
        assert number(score.held_out.rms_dph) in page.text


def test_the_spline_figure_has_one_trace_a_piece_and_meets_at_the_knots(page: Page) -> None:
    measured, *pieces, knots = page.figures()["fig-spline-data"]["data"]
    assert len(measured["x"]) == 360
    assert len(pieces) == 24
    assert len(knots["x"]) == 25
    for before, after in pairwise(pieces):
        assert before["x"][-1] == pytest.approx(after["x"][0], abs=1e-5)
        assert before["y"][-1] == pytest.approx(after["y"][0], abs=1e-5)


def section(page: Page, title: str, following: str) -> str:
    begin = page.text.rindex(title)
    return page.text[begin : page.text.index(following, begin)]


def test_what_is_missing_stands_after_the_ladder_with_numbers_commands_and_limits(page: Page, whole: Analysis) -> None:
    ids = [a["id"] for tag, a in page.tags if tag == "h2"]
    assert ids[ids.index("ladder") + 1] == "missing"
    text = section(page, "Missing effects", "Compensation over time")
    assert text.index("Missing: hysteresis (") < 60
    assert f"bench add hysteresis --model spline --out better.yaml\nbench compare {whole.run.path} --check" in text
    assert "width = 4.96 ± 0.20 °C" in text
    assert "What this run could not have shown" in text
    assert "supply_voltage" in text


def test_the_map_pales_when_the_effect_is_added(page: Page) -> None:
    before, after = (np.array(trace["z"], dtype=float) for trace in page.figures()["fig-missing-map-data"]["data"])
    assert np.nanmax(np.abs(before)) > 5
    assert np.nanmax(np.abs(after)) < 2
    assert np.array_equal(np.isnan(before), np.isnan(after))


def test_the_fitted_effect_is_drawn_as_the_loop_that_was_put_in(page: Page) -> None:
    (drawn,) = [t for t in page.figures()["fig-missing-hysteresis-data"]["data"] if t["name"] == "hysteresis"]
    heights = np.array([y for y in drawn["y"] if y is not None])
    assert np.ptp(heights) == pytest.approx(0.8, abs=0.05)


def test_an_adequate_run_says_what_it_could_have_shown_and_advises_nothing(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    page = Page(render(clean(tmp_path_factory.getbasetemp())))
    text = section(page, "Missing effects", "Compensation over time")
    assert "These data show no missing effect" in text
    assert "bench add" not in text
    assert "What this run could not have shown" in text
    drawn = {name.removeprefix("fig-").removesuffix("-data") for name in page.figures()}
    assert {"missing-map", "missing-detectable"} <= drawn
    assert not drawn & {"missing-ladder", "missing-legs"}


def test_an_unknown_effect_is_drawn_and_not_advised_as_something_else(tmp_path_factory: pytest.TempPathFactory) -> None:
    page = Page(render(disturbed(tmp_path_factory.getbasetemp())))
    assert "fig-missing-unknown-data" in page.figures()
    text = section(page, "Missing effects", "Compensation over time")
    assert "no effect of the catalogue explains" in text
    assert "period 1080 s" in text or "period 1" in text
    assert "bench add '{\"expression" in text  # the formula that fits; the nearest effect is not advised
    assert "sin(2*pi*time/" in text
    assert "fig-missing-formula-data" in page.figures()


def test_a_parameter_on_its_bound_has_no_uncertainty_but_is_called_not_determined(whole: Analysis) -> None:
    answer = whole.diagnosed.answer
    assert answer is not None
    suspect = answer.found[0]
    stuck = replace(suspect.parameters["width_degc"], value=40.0, at_bound=True)
    changed = replace(suspect, parameters={**suspect.parameters, "width_degc": stuck})
    found = replace(answer, suspects=(changed, *answer.suspects[1:]))
    shown = render(replace(whole, diagnosed=replace(whole.diagnosed, answer=found)))
    assert "width = 40.0 °C (on its bound: not determined)" in shown
    assert changed.to_json()["parameters"]["width_degc"]["at_bound"] is True
    assert "hysteresis (width_degc 40.0 degC on its bound: not determined, a" in sentence(found, drifts=False)


def test_a_diagnosis_that_was_refused_is_a_sentence(whole: Analysis) -> None:
    refused = replace(whole, diagnosed=Diagnosed(reason="too few rows to tell"))
    page = Page(render(refused))
    assert "No diagnosis" in page.text
    assert "Too few rows to tell." in page.text
    assert not any("missing" in name for name in page.figures())


def test_hostile_names_stay_text(tmp_path: Path) -> None:
    made = ramp_run()
    for segment in made["segments"]:
        segment["name"] = HOSTILE
    made["segments"][-1] |= {"settled": False, "outcome": "timeout", "reason": HOSTILE}
    run = make_run(tmp_path / "hostile", **made, unit=HOSTILE, profile=HOSTILE, cause=HOSTILE)
    keep(run, "events.jsonl", json.dumps({"t_s": 1.0, "kind": "guard", "text": HOSTILE}) + "\n")
    page = Page(render(analyse(run, [load_model("polynomial")], diagnose=False)))
    assert not any(tag == "img" for tag, _ in page.tags)
    assert not any("alert" in body and not body.startswith('{"data"') and len(body) < 1000 for body in page.scripts)
    assert HOSTILE in page.text
    assert page.figures()["fig-allan-data"]["data"][1]["name"] == HOSTILE


def test_a_run_without_data_still_makes_a_page_and_carries_no_plotting_library(tmp_path: Path) -> None:
    columns = {name: values[:0] for name, values in ramp_run()["columns"].items()}
    run = make_run(tmp_path / "zero", columns, state="failed", cause="chamber link lost")
    path = write_report(analyse(run))
    page = Page(path.read_text(encoding="utf-8"))
    assert "No data" in page.text
    assert "chamber link lost" in page.text
    assert page.figures() == {}
    assert path.stat().st_size < 50_000


def test_an_imported_table_without_a_soak_gets_all_figures_that_it_can_have(tmp_path: Path) -> None:
    made = ramp_run([("start", "soak", 25.0, 60.0), ("down", "ramp", -40.0, 2.5), ("up", "ramp", 85.0, 2.5)])
    columns = {name: made["columns"][name] for name in ("time", "rate", "temperature")}
    run = make_run(tmp_path / "imported", columns, losses={}, state="done")
    page = Page(render(analyse(run, [load_model("polynomial")], diagnose=False)))
    drawn = {name.removeprefix("fig-").removesuffix("-data") for name in page.figures()}
    assert drawn == {name for name in FIGURES if "missing" not in name} - {"channels", "spline", "allan"}
    assert "did not count its frames" in page.text
    assert "noise floor not known: no isothermal stretch" in page.text


def test_a_torn_last_event_is_said_and_does_not_cost_the_page(whole: Analysis, tmp_path: Path) -> None:
    made = ramp_run([("soak", "soak", 25.0, 60.0)])
    run = make_run(tmp_path / "torn", **made)
    with (run / "events.jsonl").open("a") as file:
        file.write('{"t_s": 3.0, "ki')
    assert "events.jsonl: 1 damaged line" in Page(render(quick(run))).text


def test_the_file_is_small_and_figures_do_not_grow_with_the_run(whole: Analysis) -> None:
    assert write_report(whole).stat().st_size - len(get_plotlyjs()) < 1_000_000
    million = np.random.default_rng(0).normal(size=1_000_000)
    million[123_456], million[654_321] = 50.0, -50.0
    rows = plotting.thin(million)
    assert rows.size <= plotting.MAX_POINTS + 3
    assert {123_456, 654_321} <= set(rows.tolist())
    assert np.all(np.diff(rows) > 0)


def test_gaps_stay_gaps_in_figures() -> None:
    values = np.array([1.0, 2.0, np.nan, 3.0, 4.0])
    trace = plotting.line_trace(np.arange(5.0), values, "x", plotting.BLUE).to_plotly_json()
    assert list(trace["y"]) == [1.0, 2.0, None, 3.0, 4.0]
    assert trace["connectgaps"] is False


def test_values_of_a_slow_log_are_seen_though_each_has_gaps_about_it() -> None:
    values = np.where(np.arange(600) % 60 == 0, 1.0, np.nan)
    assert plotting.line_trace(np.arange(600.0), values, "x", plotting.BLUE).connectgaps is True


def test_a_line_over_time_is_broken_where_the_record_pauses() -> None:
    """An hour without data was a straight line."""
    hours = np.concatenate([np.arange(0.0, 1.0, 1 / 120), np.arange(2.0, 3.0, 1 / 120)])
    trace = plotting.time_trace(hours, np.sin(hours), "x", plotting.BLUE)
    assert [at for at, value in enumerate(trace.y) if value is None] == [120]
    assert len(trace.x) == 241
    few = plotting.time_trace(np.array([0.0, 1.0, 2.0]), np.zeros(3), "x", plotting.BLUE)
    assert None not in few.y, "a row each hour"


def test_the_same_run_gives_the_same_page(whole: Analysis) -> None:
    assert render(whole) == render(whole)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1234"), (0.012345, "0.0123"), (1.5948, "1.59"), (-40.0, "-40.0"), (3e-7, "3.00e-07")],
)
def test_numbers_have_three_significant_digits(value: float, text: str) -> None:
    assert number(value) == text
    assert number(float("nan")) == "–"


def test_values_are_written_to_the_last_digit_that_their_uncertainty_allows() -> None:
    assert with_uncertainty(12.3456, 0.0123) == ("12.346", "0.012")
    assert with_uncertainty(-8.9123e-6, 1.83e-6) == ("-8.9e-06", "1.8e-06")
    assert with_uncertainty(14000.123, 120.0) == ("14000", "120")
    assert with_uncertainty(1.0, float("nan")) == ("1.00000", "–")


def test_units_and_dates_read_as_people_write_them() -> None:
    assert in_print("deg/h/degC^2") == "deg/h/°C²"
    assert moment("2026-11-21T08:00:00+02:00") == "2026-11-21 06:00 UTC"
    assert moment("no date") == "no date"


def test_a_figure_cannot_end_its_script_early() -> None:
    html = figure("f", {"data": [{"name": "</script>"}], "layout": {"height": 100}}, "c", "a")
    assert html.count("</script>") == 1


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
@pytest.mark.slow
def test_a_browser_draws_every_figure_offline(whole: Analysis, tmp_path: Path) -> None:
    path = write_report(whole)
    flags = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking",
        "--disable-component-update --disable-sync --virtual-time-budget=20000 --dump-dom",
    )
    command = [str(CHROMIUM), *" ".join(flags).split(), f"--user-data-dir={tmp_path / 'profile'}", path.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.count('class="main-svg"') >= len(FIGURES)
    assert done.stdout.count('class="plot js-plotly-plot"') == len(FIGURES)


@pytest.mark.skipif(CHROMIUM is None or shutil.which("pdftotext") is None, reason="no chromium or no poppler here")
@pytest.mark.slow
def test_on_paper_no_heading_stands_alone_at_the_foot_of_a_page(whole: Analysis, tmp_path: Path) -> None:
    path, pdf = write_report(whole), tmp_path / "report.pdf"
    flags = (
        f"--headless --no-sandbox --disable-gpu --virtual-time-budget=20000 --no-pdf-header-footer --print-to-pdf={pdf}"
    )
    command = [str(CHROMIUM), *flags.split(), f"--user-data-dir={tmp_path / 'profile'}", path.as_uri()]
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    printed = subprocess.run(["pdftotext", "-layout", str(pdf), "-"], capture_output=True, text=True, check=True)
    last = [page.strip().splitlines()[-1].strip() for page in printed.stdout.split("\f") if page.strip()]
    html = path.read_text(encoding="utf-8")
    before = re.findall(r"<(?:h2|h3|dt)[^>]*>([^<]+)<|<p[^>]*>([^<]+)</p>\s*(?=<figure|<div class=.scroll)", html)
    alone = ["".join(one).strip() for one in before]
    assert len(last) > 4
    assert [line for line in last if any(text.endswith(line) for text in alone)] == []


@pytest.mark.parametrize("simulated", [True, False])
def test_a_report_of_a_simulated_run_says_so_above_everything(tmp_path, simulated):
    run = make_run(tmp_path / "run", **ramp_run(loop_dph=0.0), simulated=simulated)
    html = render(quick(run, "polynomial"))
    assert ("<strong>Simulated.</strong>" in html.split("Verdict")[0]) == simulated
