"""Runs of several units: compared, never pooled in one fit, unless a lot is asked for."""

import json

import pytest

import bench as api
from bench.base import InputError
from tests.support.commands import bench
from tests.support.run_folders import make_run, ramp_run


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    folder = tmp_path_factory.mktemp("units")
    return [make_run(folder / unit, **ramp_run(seed=seed), unit=unit) for seed, unit in enumerate(("A-1", "B-2"))]


@pytest.mark.parametrize("how", ["fitted", "checked", "static"])
def test_a_fit_to_two_units_is_refused_in_one_line(two, how):
    first, second = two
    runs = {"fitted": [first, second], "checked": [first, "--check", second], "static": [first, "--static", second]}
    answer = bench("compare", *runs[how], "--model", "polynomial")
    assert answer.exit_code == 2
    (line,) = answer.stderr.splitlines()
    assert "2 units (A-1, B-2)" in line
    assert "--lot" in line


@pytest.mark.parametrize("command", ["diagnose", "improve"])
def test_a_diagnosis_of_two_units_is_refused(two, command):
    answer = bench(command, *two, "--model", "polynomial")
    assert answer.exit_code == 2
    assert "A-1, B-2" in answer.stderr


@pytest.mark.parametrize("more", [(), ("--every-sample",)])
def test_a_lot_is_fitted_when_asked_for(two, more):
    if more:
        assert bench("compare", *two, "--model", "polynomial", *more).exit_code == 2
    answer = bench("compare", *two, "--lot", "--model", "polynomial", "--json", *more)
    assert answer.exit_code == 0, answer.stderr
    assert len(json.loads(answer.stdout)["runs"]) == 2


def test_the_api_refuses_them_as_well(two):
    runs = [api.open(folder) for folder in two]
    for ask in (api.compare, api.fit, api.diagnose):
        with pytest.raises(InputError, match="2 units"):
            ask(runs, *([] if ask is api.compare else ["polynomial"]))
    assert api.compare(runs, ["polynomial"], lot=True)
