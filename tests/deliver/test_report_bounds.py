"""Figures do not grow with the record: of a long line only the lowest and highest points are drawn."""

from __future__ import annotations

import json
import re

import pytest

from bench.deliver.report.html import render
from bench.deliver.report.plotting import MAX_POINTS
from tests.support.report_runs import quick
from tests.support.run_folders import CYCLE, make_run, ramp_run


@pytest.mark.slow
def test_a_record_of_a_day_and_a_half_has_no_more_points_to_a_trace_than_fit_the_screen(tmp_path):
    page = render(quick(make_run(tmp_path / "run", **ramp_run(CYCLE * 12, rate_hz=0.5)), "spline"))
    found = re.findall(r'<script[^>]*>(\{"data".*?)</script>', page, re.DOTALL)
    sizes = [len(trace.get(axis) or ()) for body in found for trace in json.loads(body)["data"] for axis in "xy"]
    assert max(sizes) <= MAX_POINTS + 3
    assert max(sizes) > MAX_POINTS / 2  # the record is long enough to be thinned
