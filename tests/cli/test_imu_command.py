"""`bench imu`: a table and a plan in, parameters with U and what is wrong out; bad input is one line."""

import csv
import json
import shutil

import numpy as np
import pytest
import yaml

from bench.record import ImuRecord, ImuVerificationRecord, sha256
from benchmarks import imu_data
from drivers.sim.truth.imu.drawn import drawn
from tests.support.commands import bench


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
    return bench("imu", folder / "imu.csv", "--plan", folder / "changed.yaml", *words)


def test_a_unit_is_calibrated_from_its_table_and_plan(folder):
    answer = asked(folder, "--json", "--out", str(folder / "found.csv"))
    found = json.loads(answer.stdout)
    assert found["files"] == [str(folder / "found.csv")]
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


@pytest.fixture(scope="module")
def calibrated(folder):
    """The folder with the record, and the answer; two soaks determine scale factors of order 1."""
    words = "--json", "--out", str(folder / "cal"), "--unit", "SIM-IMU-0001"
    answer = asked(folder, *words, orders={"bias": 2, "scale_factor": 1})
    shutil.copy(folder / "changed.yaml", folder / "cal.yaml")
    return folder / "cal", answer


def test_the_result_is_kept_as_a_record_that_names_what_it_was_made_from(folder, calibrated):
    out, answer = calibrated
    found, record = json.loads(answer.stdout), ImuRecord.read(out)
    assert found["files"] == [str(out / name) for name in ("imu.json", "parameters.csv", "report.html")]
    assert record.unit == "SIM-IMU-0001"
    digests = {source.file: source.sha256 for source in record.sources}
    assert digests == {"imu.csv": sha256(folder / "imu.csv"), "changed.yaml": sha256(folder / "cal.yaml")}
    assert [one.value for one in record.parameters] == [one["value"] for one in found["parameters"]]
    assert len(record.time_s) == found["rows"]
    assert list(record.undetermined) == found["undetermined"]
    assert record.sample_hz == pytest.approx(1.0)
    # The simulated unit: 0.1 deg/sqrt(h) is 6 deg/h/sqrt(Hz), 0.03 m/s/sqrt(h) is 5e-4 m/s^2/sqrt(Hz).
    assert [axis.noise_density for axis in record.gyro.axes] == pytest.approx([6.0] * 3, rel=0.1)
    assert [axis.noise_density for axis in record.accelerometer.axes] == pytest.approx([5e-4] * 3, rel=0.2)
    assert {position.rate_dps for position in record.positions} == {0.0, 90.0, -90.0, 120.0, -120.0}
    assert (out / "parameters.csv").is_file()


def test_a_json_file_holds_the_record_alone(folder):
    answer = asked(folder, "--out", str(folder / "alone.json"))
    assert answer.exit_code in {0, 1}, answer.output
    assert ImuRecord.at(folder / "alone.json").unit == ""


def other_table(folder, name, moves, **changes):
    imu_data.written(drawn(1), imu_data.at_home(), 7, moves, folder, name)
    plan = yaml.safe_load((folder / f"{name}.yaml").read_text()) | changes
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(plan, sort_keys=False))


def verified(folder, name, *words):
    plan = folder / f"{name}.yaml"
    return bench("imu", folder / f"{name}.csv", "--plan", plan, "--verify", folder / "cal", *words)


def elsewhere(seed, degc=39.0, rates=(0.0, 40.0, -75.0)):
    """Attitudes and rates that no calibration had."""
    random = np.random.default_rng(seed)
    ups = random.standard_normal((12, 3)).tolist()
    attitudes = [imu_data.Attitude.of(f"other {i}", tuple(up), 30.0 * i) for i, up in enumerate(ups)]
    return [imu_data.Move(a, rates[i % len(rates)], degc) for i, a in enumerate(attitudes) for _ in range(2)]


def test_a_calibration_is_verified_by_other_attitudes_and_rates(folder, calibrated):
    other_table(folder, "other", elsewhere(1))
    answer = verified(folder, "other", "--json")
    found = json.loads(answer.stdout)
    assert answer.exit_code == (0 if found["verdict"] in {"PASS", "MARGINAL"} else 1)
    assert (found["rows"], found["fitted_rows"], found["rows_beyond"]) == (24, 0, 0)
    assert ImuVerificationRecord.read(folder / "cal").verdict == found["verdict"] == "PASS"
    for axis in found["axes"]:
        assert axis["rms"] < 0.2 * axis["raw_rms"]
        assert axis["floor"] < axis["stated"]
        assert 0.3 * axis["floor"] < axis["rms"] < 12.0 * axis["floor"]
        assert axis["interval"][0] < axis["rms"] < axis["interval"][1]


def test_a_verification_is_judged_by_limits_and_fails_where_the_unit_changed(folder, calibrated):
    other_table(folder, "bad", elsewhere(2))
    lines = (folder / "bad.csv").read_text().splitlines()
    at = lines[0].split(",").index("rate_y")
    changed = [
        [*row[:at], f"{float(row[at]) + 25.0}", *row[at + 1 :]] for row in (line.split(",") for line in lines[1:])
    ]
    (folder / "bad.csv").write_text("\n".join([lines[0], *(",".join(row) for row in changed)]) + "\n")
    limits = folder / "limits.yaml"
    limits.write_text(
        "name: imu\nlimits:\n"
        "  - {quantity: gyro_error_rms_dph, unit: deg/h, upper: 15, reason: budget}\n"
        "  - {quantity: accelerometer_error_rms_mps2, unit: m/s^2, upper: 0.05, reason: budget}\n"
    )
    answer = verified(folder, "bad", "--limits", limits, "--json")
    assert answer.exit_code == 1, answer.output
    found = json.loads(answer.stdout)
    words = {one["name"]: one["verdict"] for one in found["limits"]["results"]}
    assert words == {"gyro_error_rms_dph": "FAIL", "accelerometer_error_rms_mps2": "PASS"}
    assert found["verdict"] == "FAIL"
    assert found["axes"][1]["mean"] == pytest.approx(25.0, abs=5.0)
    own = verified(folder, "bad")  # without limits: by what the calibration states
    assert own.exit_code == 1
    assert own.stdout.startswith("FAIL")
    assert "gyro y: most of its error is its mean" in own.stdout


def test_rows_that_were_fitted_or_lie_beyond_the_range_verify_nothing(folder, calibrated):
    other_table(
        folder, "mixed", [*elsewhere(3)[:4], *elsewhere(3, 80.0)[:6], *imu_data.calibration(1, (20.0,), 4.0)[:30]]
    )
    found = json.loads(verified(folder, "mixed", "--json").stdout)
    assert found["rows"] == 4
    assert found["fitted_rows"] > 15
    assert found["rows_beyond"] >= 4
    other_table(folder, "same", imu_data.calibration(1, (20.0,), 4.0)[:30])
    answer = verified(folder, "same")
    assert answer.exit_code == 2
    assert "no row of" in answer.stderr
    assert "measure other positions or rates" in answer.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--verify", "CAL"), "is what this calibration was fitted to; verify with another"),
        (("--verify", "CAL", "--out", "x"), "--verify calibrates nothing"),
        (("--limits", "x.yaml"), "name the calibration with --verify"),
        (("--verify", "FOLDER"), "is no calibration of an inertial unit"),
        (("--out", "FOLDER/none/cal"), "does not exist; make it first"),
    ],
)
def test_what_cannot_be_verified_or_kept_is_one_line(folder, calibrated, words, said):
    own = [str(calibrated[0]) if w == "CAL" else w.replace("FOLDER", str(folder)) for w in words]
    answer = asked(folder, *own)
    assert answer.exit_code == 2, answer.output
    assert said in answer.stderr
