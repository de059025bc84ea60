"""`bench imu`: a table and a plan in, parameters with U and what is wrong out; bad input is one line."""

import csv
import json

import pytest
import yaml
from click.testing import CliRunner

from bench.cli import main
from benchmarks import imu_data
from drivers.sim.truth.imu.drawn import drawn


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("imu")
    plan = imu_data.calibration(1, (-10.0, 40.0), 4.0)
    imu_data.written(drawn(1), imu_data.at_home(), 1, plan, place)
    return place


def asked(folder, *words, **changes):
    """The command on the table with a changed plan."""
    plan = yaml.safe_load((folder / "imu.yaml").read_text()) | changes
    (folder / "changed.yaml").write_text(yaml.safe_dump(plan, sort_keys=False))
    return CliRunner().invoke(main, ["imu", str(folder / "imu.csv"), "--plan", str(folder / "changed.yaml"), *words])


def test_a_unit_is_calibrated_from_its_table_and_plan(folder):
    answer = asked(folder, "--json", "--out", str(folder / "found.csv"))
    found = json.loads(answer.stdout)
    assert set(found) == {"table", "out", "rows", "left_out", "range_degc", "parameters", "undetermined", "findings"}
    assert answer.exit_code == (1 if found["findings"] or found["undetermined"] else 0)
    assert found["rows"] > 60
    at = sorted({one["temperature_degc"] for one in found["parameters"]})[3]
    true = dict(imu_data.truth(drawn(1), "gyro", at)) | dict(imu_data.truth(drawn(1), "accelerometer", at))
    mine = [one for one in found["parameters"] if one["temperature_degc"] == at]
    assert len(mine) == 36
    for one in mine:
        if one["kind"] in {"scale factor", "misalignment"}:
            assert abs(one["value"] - true[one["name"]]) < 3.0 * one["U"], one
    rows = list(csv.DictReader((folder / "found.csv").read_text().splitlines()))
    assert [row["parameter"] for row in rows] == [one["name"] for one in found["parameters"]]
    assert float(rows[5]["U"]) == pytest.approx(found["parameters"][5]["U"], rel=1e-3)


def test_an_attitude_that_gravity_contradicts_is_refused_with_its_line(folder):
    stays = yaml.safe_load((folder / "imu.yaml").read_text())["stays"]
    number = next(i for i, stay in enumerate(stays) if stay["attitude"] == "x_up")
    stays[number]["attitude"] = "y_down"
    answer = asked(folder, stays=stays)
    assert answer.exit_code == 2
    start = f"- from_s: {stays[number]['from_s']}"
    line = (folder / "changed.yaml").read_text().splitlines().index(start) + 1
    assert f"changed.yaml:{line}: " in answer.stderr
    assert "attitude y_down is stated, but gravity is 90 deg from there, as in x_up" in answer.stderr


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"stays": [{"from_s": 0.0, "to_s": 60.0, "attitude": "x_upp"}]}, "attitude 'x_upp' is not known"),
        ({"stays": [{"from_s": 0.0, "to_s": 60.0}]}, "a stay needs either attitude or up"),
        ({"stays": [{"from_s": 60.0, "to_s": 60.0, "attitude": "x_up"}]}, "to_s is 60, allowed is more than from_s"),
        ({"stays": [{"from_s": 0.0, "to_s": 30.0, "attitude": "x_up"}]}, "no stay is as long as a row of 60 s"),
        ({"latitude": 3}, "latitude"),
        ({"row_s": 1.0}, "raise it to"),
        ({"gyro_thermometers": ["temperature", "temperature_2", "temperature_3"]}, "channel 'temperature' is missing"),
    ],
)
def test_what_is_wrong_with_a_plan_is_one_line(folder, changes, said):
    answer = asked(folder, **changes)
    assert answer.exit_code == 2, answer.output
    assert said in answer.stderr
    assert "Traceback" not in answer.output
    assert len(answer.stderr.strip().splitlines()) <= 2


def test_what_a_plan_cannot_determine_is_refused_by_name(folder):
    stays = [stay for stay in yaml.safe_load((folder / "imu.yaml").read_text())["stays"] if stay["attitude"] != "x_up"]
    stays = [stay for stay in stays if stay["attitude"] in {"z_up", "z_down", "y_up", "y_down"}]
    answer = asked(folder, stays=stays, orders={"bias": 0, "scale_factor": 0, "misalignment": 0, "g_sensitivity": 0,
                                                "second_order": 0})  # fmt: skip
    assert answer.exit_code == 2
    assert "do not determine" in answer.stderr
    assert "gyro x: g-sensitivity along x: nothing drives it" in answer.stderr
