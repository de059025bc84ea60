"""`bench check` answers in time, with one clear line, whatever stands in profile, station or DBC."""

import json

import pytest

from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run import rehearsal
from bench.acquisition.run.rehearsal import rehearse
from drivers.sim.plant import Plant
from tests.support import acquisition
from tests.support.commands import bench

SOAK = (
    "name: p\nsegments:\n  - {{kind: soak, duration_min: {}}}\n  - {{kind: ramp, to_degc: 25, rate_degc_per_min: 2}}\n"
)
DBC = """VERSION ""
NS_ :
BS_:
BU_: Gyro
BO_ 100 OUT: 8 Gyro
 SG_ Rate : 0|24@1- (0.0001,0) [-700|700] "deg/s" Gyro
BO_ 100 AGAIN: 8 Gyro
 SG_ Other : 0|24@1- (0.0001,0) [-700|700] "deg/s" Gyro
"""


def check(tmp_path, profile, **station):
    (tmp_path / "profile.yaml").write_text(profile)
    (tmp_path / "station.yaml").write_text(json.dumps(acquisition.station_content(**station)))
    return bench("check", tmp_path / "profile.yaml", "--station", tmp_path / "station.yaml")


@pytest.mark.slow
def test_of_a_long_soak_the_end_is_not_modelled_and_the_times_are_the_same(monkeypatch):
    profile, settings = profile_from_text(SOAK.format(300)), acquisition.station()
    shortened = rehearse(profile, settings)
    monkeypatch.setattr(rehearsal, "SOAK_S", 1e9)
    whole = rehearse(profile, settings)
    assert shortened[0].to_s == whole[0].to_s
    assert shortened[1].to_s == pytest.approx(whole[1].to_s, abs=30.0)


@pytest.mark.slow
def test_a_soak_of_ten_weeks_and_a_ramp_of_one_are_answered(monkeypatch):
    calls = []
    step = Plant.step
    monkeypatch.setattr(Plant, "step", lambda *a, **k: calls.append(1) or step(*a, **k))
    soak = rehearse(profile_from_text(SOAK.format("1e5")), acquisition.station())
    assert soak[0].to_s == pytest.approx(6e6, rel=1e-3)
    assert len(calls) < 20_000
    slow = "name: p\nsegments:\n  - {kind: ramp, to_degc: 80, rate_degc_per_min: 0.002}\n"
    (ramp,) = rehearse(profile_from_text(slow), acquisition.station())
    assert (ramp.outcome, "too long to be rehearsed" in ramp.reason) == ("done", True)
    assert ramp.to_s == pytest.approx(57 / 0.002 * 60, rel=1e-3)


@pytest.mark.parametrize("rate", ["1e-308", "1e-9", "0"])
def test_a_ramp_that_never_ends_is_one_line(rate, tmp_path):
    answer = check(tmp_path, f"name: p\nsegments:\n  - {{kind: ramp, to_degc: 30, rate_degc_per_min: {rate}}}\n")
    assert answer.exit_code == 2
    assert "profile.yaml:3: segments[0].rate_degc_per_min is" in answer.stderr
    assert answer.stderr.count("\n") == 1


@pytest.mark.parametrize("number", ["9" * 4400, "-" + "9" * 4400, "0x" + "f" * 5000, "0o" + "7" * 5000])
def test_a_number_of_thousands_of_digits_is_one_line(number, tmp_path):
    answer = check(tmp_path, SOAK.format(number))
    assert answer.exit_code == 2
    assert "profile.yaml:3: '" in answer.stderr
    assert "is not a finite number" in answer.stderr
    assert len(answer.stderr) < 300


def test_the_dbc_is_read_and_two_messages_with_one_identifier_are_one_line(tmp_path, caplog):
    (tmp_path / "two.dbc").write_text(DBC)
    units = [{**acquisition.station_content()["units"][0], "gyro": str(tmp_path / "two.dbc")}]
    answer = check(tmp_path, SOAK.format(1), units=units)
    assert answer.exit_code == 2
    text = f"DBC {tmp_path / 'two.dbc'}: OUT and AGAIN have the same identifier 0x64; give each message its own\n"
    assert answer.stderr == f"bench: {tmp_path / 'station.yaml'}:1: unit SIM-0001: {text}"


def test_a_dbc_that_is_not_there_is_said_before_the_run(tmp_path):
    units = [{**acquisition.station_content()["units"][0], "gyro": "nowhere"}]
    answer = check(tmp_path, SOAK.format(1), units=units)
    assert (answer.exit_code, "unit SIM-0001: no gyro 'nowhere' is shipped: vibratory" in answer.stderr) == (2, True)
