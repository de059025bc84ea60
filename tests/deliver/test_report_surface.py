"""The report of a run on a rate table shows both surfaces in space and C0 to C20; other reports stay small."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from bench.deliver.report.html import render
from tests.support.report_runs import clean, quick
from tests.support.run_folders import make_run, ramp_run


def on_a_table(folder, steps: int):
    """A run whose table steps through rates while the temperature moves."""
    made = ramp_run(loop_dph=0.0)
    columns = made["columns"]
    rate = 20.0 * np.round(steps * np.sin(columns["time"] / 400.0))
    columns["applied_rate"] = rate
    columns["rate"] = columns["rate"] + 3600.0 * rate * (1.0 + 1e-3 + 2e-5 * (columns["temperature"] - 25.0))
    return quick(make_run(folder, **made), "rate_surface" if steps > 3 else "polynomial")


@pytest.fixture(scope="module")
def turned(tmp_path_factory) -> str:
    return render(on_a_table(tmp_path_factory.mktemp("surface") / "run", 5))


def figure(html: str, name: str):
    found = re.search(rf'<script type="application/json" id="{name}-data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def test_both_surfaces_stand_in_space_with_their_units(turned):
    measured, fitted = figure(turned, "fig-surface-measured"), figure(turned, "fig-surface-fitted")
    assert [trace["type"] for trace in measured["data"]] == ["mesh3d", "scatter3d"]
    assert [trace["type"] for trace in fitted["data"]] == ["surface"]
    for plot in (measured, fitted):
        scene = plot["layout"]["scene"]
        assert "deg/s" in scene["xaxis"]["title"]["text"]
        assert "deg/h" in scene["zaxis"]["title"]["text"]
    assert np.all(np.isfinite(np.array(fitted["data"][0]["z"], dtype=float)))


def test_all_coefficients_are_there_in_their_order(turned):
    section = turned[turned.index("Rate surface</h2>") :]
    names = re.findall(r'scope="row">C(\d+)<', section)
    assert names == [str(k) for k in range(21)]
    assert "u^1 v^0" in section
    assert "least squares and orthogonal polynomials differ by" in section


def test_a_table_with_few_rates_is_told_and_draws_nothing(tmp_path):
    html = render(on_a_table(tmp_path / "run", 1))
    assert "No surface of order 5" in html
    assert "fig-surface" not in html


def test_a_unit_that_was_not_turned_has_no_surface(tmp_path_factory):
    assert "Rate surface" not in render(clean(tmp_path_factory.mktemp("clean")))
