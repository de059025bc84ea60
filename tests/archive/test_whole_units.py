"""The calibration of a whole inertial unit in the registry: it is that of the run that it was fitted to."""

import pytest

from bench.commands import registry_rebuild
from bench.record import FlashRecord, ImuSource, Manifest, fitted_runs, sha256, whole_fitted_to
from bench.web.ground.settings import Settings
from tests.deliver.test_imu_certificate import verification
from tests.support.imu_units import imu_record
from tests.support.run_folders import make_run, ramp_run
from tests.support.web_client import served

UNIT = "SIM-IMU-0042"


def stood(root, name, attitude="z_up", seed=1):
    """A run in which the unit stands in a known attitude."""
    made = ramp_run(seed=seed)
    segments = [{**segment, "attitude": attitude} for segment in made["segments"]]
    return make_run(root / UNIT / name, made["columns"], segments, unit=UNIT)


def source(run):
    return ImuSource(file=f"{run.name}/means.parquet", sha256=sha256(run / "means.parquet"))


@pytest.fixture
def made(tmp_path):
    """The archive, the run that was fitted, the run that verifies, and the folder of the calibration."""
    run, check = (stood(tmp_path, f"20261121T0{hour}0000Z_imu", seed=hour) for hour in (6, 8))
    whole = tmp_path / UNIT / f"{run.name}_imu"
    whole.mkdir()
    imu_record().model_copy(update={"sources": (source(run),)}).write(whole)
    return tmp_path, run, check, whole


def told(root):
    registry_rebuild(root, None, False)
    with served(Settings(root)) as client:
        (line,) = client.get("/api/v1/units").json()["units"]
        return line["standing"], client.get(f"/api/v1/units/{UNIT}").json()


def test_runs_and_calibration_are_found_beside_each_other(made):
    root, run, check, whole = made
    assert (fitted_runs(whole), whole_fitted_to(run), whole_fitted_to(check)) == ((run,), whole, None)
    make_run(run, ramp_run(seed=9)["columns"], Manifest.read(run).content()["segments"], unit=UNIT)
    assert whole_fitted_to(run) is None, "fitted to other data than the run has now"
    assert fitted_runs(root / UNIT) == ()


def test_a_unit_is_calibrated_where_its_whole_calibration_was_verified(made):
    root, _, check, whole = made
    standing, history = told(root)
    (calibration,) = history["calibrations"]
    assert (standing, calibration["status"], calibration["model"]) == ("unjudged", "not_passed", "imu")
    verification().model_copy(update={"sources": (source(check),)}).write(whole)
    standing, history = told(root)
    (calibration,) = history["calibrations"]
    assert (standing, calibration["status"], calibration["judged"]) == ("pass", "newest", "PASS")
    assert calibration["validity"]["temperature"] == {"from": -28.0, "to": 70.0}
    assert [(one["kind"], one["judged"]) for one in history["runs"]] == [
        ("verification", "PASS"),
        ("calibration", "PASS"),
    ]
    (root / UNIT / "flash").mkdir()
    written = FlashRecord(utc="2026-11-21T09:00:00+00:00", state="done", run=str(whole))
    written.write(root / UNIT / "flash", "20261121T090000Z.json")
    assert told(root)[1]["calibrations"][0]["status"] == "in_unit"


def test_a_damaged_record_does_not_hide_the_history_of_the_unit(made):
    root, _, check, whole = made
    verification().model_copy(update={"sources": (source(check),)}).write(whole)
    registry_rebuild(root, None, False)
    for name in ("imu.json", "imu_verification.json"):
        (whole / name).write_text("{")
    with served(Settings(root)) as client:
        answer = client.get(f"/api/v1/units/{UNIT}")
    assert (answer.status_code, len(answer.json()["runs"])) == (200, 2)


def test_a_whole_calibration_outside_its_limits_does_not_pass(made):
    root, _, _, whole = made
    verification("FAIL").write(whole)
    standing, history = told(root)
    assert (standing, history["calibrations"][0]["status"]) == ("fail", "not_passed")
