"""Gauge R&R: the example of the manual to its digits, REML as statsmodels has it, intervals that cover."""

import json

import numpy as np
import pytest

from bench.archive.fleet.gauge import gauge
from bench.base import InputError
from tests.support.commands import bench
from tests.support.fleet_runs import station

# AIAG, Measurement Systems Analysis, 4th ed. (2010), figure III-B 15: 10 parts, three trials of A, B, C.
AIAG = {
    "A": """0.29 0.41 0.64 -0.56 -0.68 -0.58 1.34 1.17 1.27 0.47 0.50 0.64 -0.80 -0.92 -0.84
        0.02 -0.11 -0.21 0.59 0.75 0.66 -0.31 -0.20 -0.17 2.26 1.99 2.01 -1.36 -1.25 -1.31""",
    "B": """0.08 0.25 0.07 -0.47 -1.22 -0.68 1.19 0.94 1.34 0.01 1.03 0.20 -0.56 -1.20 -1.28
        -0.20 0.22 0.06 0.47 0.55 0.83 -0.63 0.08 -0.34 1.80 2.12 2.19 -1.68 -1.62 -1.50""",
    "C": """0.04 -0.11 -0.15 -1.38 -1.13 -0.96 0.88 1.09 0.67 0.14 0.20 0.11 -1.46 -1.07 -1.45
        -0.29 -0.67 -0.49 0.02 0.01 0.21 -0.46 -0.56 -0.49 1.77 1.45 1.87 -1.49 -1.77 -2.16""",
}


def manual():
    rows = [(f"P{i // 3}", who, float(word)) for who, text in AIAG.items() for i, word in enumerate(text.split())]
    units, stations, values = zip(*rows, strict=True)
    return np.array(values), units, stations


def by_name(found):
    return {one.name: one for one in found.components}


def test_the_example_of_the_manual_has_its_numbers():
    found = gauge(*manual())
    table = {one.name: one for one in found.sources}
    assert table["unit"].squares == pytest.approx(88.3619, abs=5e-5)
    assert table["station"].squares == pytest.approx(3.1673, abs=5e-5)
    assert table["repetitions"].squares == pytest.approx(0.3590 + 2.7589, abs=1e-4)  # interaction pooled, p = 0.974
    assert table["repetitions"].freedom == 78
    assert table["unit"].f == pytest.approx(245.614, abs=5e-4)
    assert table["station"].f == pytest.approx(39.617, abs=5e-4)
    sigma = {name: one.sigma for name, one in by_name(found).items()}
    assert sigma["repeatability"] == pytest.approx(0.199933, abs=5e-7)
    assert sigma["reproducibility"] == pytest.approx(0.226838, abs=5e-7)
    assert sigma["gauge"] == pytest.approx(0.302373, abs=2e-6)  # the manual adds rounded variances
    assert sigma["unit"] == pytest.approx(1.04233, abs=5e-6)
    assert sigma["total"] == pytest.approx(1.0853, abs=5e-5)
    assert 100 * by_name(found)["gauge"].of_study == pytest.approx(27.86, abs=0.005)
    assert found.categories == 4
    assert found.acceptable


def test_likelihood_gives_what_the_analysis_of_variance_gives_where_that_is_exact():
    for one in gauge(*manual()).components:
        assert one.reml_sigma == pytest.approx(one.sigma, rel=1e-4, abs=1e-6)


def study(seed, units=10, stations=3, trials=3, sigmas=(0.2, 0.3, 0.15, 1.0)):
    random = np.random.default_rng(seed)
    own, place, crossed, unit = sigmas
    table = random.normal(0, own, (units, stations, trials)) + random.normal(0, place, (1, stations, 1))
    table += random.normal(0, crossed, (units, stations, 1)) + random.normal(0, unit, (units, 1, 1))
    rows = [(f"U{i}", f"S{j}") for i in range(units) for j in range(stations) for _ in range(trials)]
    return table.ravel(), [row[0] for row in rows], [row[1] for row in rows]


def test_likelihood_is_that_of_statsmodels_where_runs_are_missing():
    sm = pytest.importorskip("statsmodels.api")
    pandas = pytest.importorskip("pandas")
    values, units, stations = study(3, units=12, stations=4)
    keep = np.random.default_rng(1).permutation(values.size)[:110]
    units, stations = ([names[i] for i in keep] for names in (units, stations))
    found = gauge(values[keep], units, stations)
    assert found.sources == ()
    table = pandas.DataFrame({"y": values[keep], "u": units, "s": stations, "one": 1})
    parts = {"station": "0 + C(s)", "interaction": "0 + C(u):C(s)", "unit": "0 + C(u)"}
    judge = sm.MixedLM.from_formula("y ~ 1", groups="one", vc_formula=parts, re_formula="0", data=table).fit(reml=True)
    theirs = dict(zip(judge.model.exog_vc.names, np.sqrt(judge.vcomp), strict=True))
    mine = by_name(found)
    assert mine["repeatability"].sigma == pytest.approx(np.sqrt(judge.scale), rel=2e-3)
    for name, sigma in theirs.items():
        assert mine[name].sigma == pytest.approx(sigma, rel=5e-3)


def test_intervals_cover_as_often_as_they_say():
    hits, truth = dict.fromkeys(("repeatability", "gauge", "unit"), 0), np.array((0.2, 0.3, 0.15, 1.0))
    aim = {"repeatability": 0.2, "gauge": float(np.sqrt(np.sum(truth[:3] ** 2))), "unit": 1.0}
    for seed in range(24):
        for name, one in by_name(gauge(*study(seed))).items():
            if name in hits:
                hits[name] += one.low <= aim[name] <= one.high
    assert all(hit >= 20 for hit in hits.values())


@pytest.mark.parametrize(
    ("units", "stations", "said"),
    [
        (["a", "a", "b", "b"], ["S", "T", "S", "S"], "fewer than two units"),
        (["a", "a", "b", "b"], ["S", "T", "S", "T"], "no unit was measured twice"),
    ],
)
def test_runs_that_are_no_study_are_refused(units, stations, said):
    with pytest.raises(InputError, match=said):
        gauge(np.arange(4.0), units, stations)


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    root = tmp_path_factory.mktemp("gauge") / "reports"
    values, units, stations = study(5, units=6, stations=2, trials=2, sigmas=(0.002, 0.004, 0.0, 0.02))
    for i, (value, unit, place) in enumerate(zip(values, units, stations, strict=True)):
        station(root, unit, place, i / 10.0, residual=0.1 + value)
    station(root, "ONCE-1", "S0", 9.0, residual=0.1)
    assert bench("registry", "rebuild", "--out", root).exit_code == 0
    return root


def test_the_command_studies_units_that_stations_measured_again(shelf, tmp_path):
    limits = tmp_path / "limits.yaml"
    text = "name: line\nlimits:\n  - {quantity: residual_rms_dph, unit: deg/h, lower: 0.0, upper: %s, reason: budget}\n"
    limits.write_text(text % 0.2)
    said = bench("fleet", "gauge", "residual_rms_dph", "--out", shelf, "--limits", limits, "--json")
    found = json.loads(said.stdout)
    assert (found["units"], found["stations"], found["runs"]) == (6, ["S0", "S1"], 24)
    wanted = "quantity unit left_out units stations runs sources components categories share acceptable"
    assert set(found) == set(wanted.split())
    parts = {one["name"]: one for one in found["components"]}
    assert parts["gauge"]["of_tolerance"] == pytest.approx(6.0 * parts["gauge"]["sigma"] / 0.2)
    assert said.exit_code == 0
    limits.write_text(text % 0.101)
    tight = bench("fleet", "gauge", "residual_rms_dph", "--out", shelf, "--limits", limits, "--unit-filter", "U[01]")
    assert "2 units at 2 stations" in tight.output
    assert "repeatability" in tight.output


def test_a_quantity_that_no_run_has_is_bad_input(shelf):
    said = bench("fleet", "gauge", "bias_dhp", "--out", shelf)
    assert said.exit_code == 2
    assert "no run has the quantity 'bias_dhp'" in said.stderr
    assert "did you mean" in said.stderr
