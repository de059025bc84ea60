"""Faults in a station file: what is refused, what is told, and a unit that dies among four, with one command."""

import json
from pathlib import Path

import pytest
import yaml

from bench.acquisition.run.runner import run_job
from bench.acquisition.station.settings.faults import OF_BUS, OF_CHAMBER, OF_UNIT
from bench.base.errors import InputError
from tests.acquisition.test_several import FOUR, SERIALS
from tests.support import acquisition
from tests.support.commands import bench


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"fault": "nonsense"}, "fault 'nonsense' on chamber: must be one of delay"),
        ({"fault": "loss", "on": "can9"}, "on is 'can9': must be chamber, a bus, a unit or an instrument"),
        ({"fault": "reset", "on": "can0"}, "fault 'reset' on can0: must be one of loss"),
        ({"fault": "bus_off", "on": "SIM-0001"}, "fault 'bus_off' on SIM-0001"),
        ({"fault": "setpoint"}, "fault 'setpoint' needs a `value`"),
        ({"fault": "silence", "share": 2}, "share"),
    ],
)
def test_what_cannot_be_rehearsed_is_refused_with_its_place(fault, said):
    with pytest.raises(InputError) as refused:
        acquisition.station(faults=[{"at_s": 1, **fault}])
    assert said in str(refused.value)
    assert "faults[0]" in str(refused.value) or "faults.0" in str(refused.value)


def test_a_real_station_rehearses_nothing():
    buses = {"can0": {"interface": "socketcan", "channel": "can0"}}
    chamber = acquisition.station_content()["chamber"] | {"connection": {"url": "tcp://127.0.0.1:1"}}
    faults = [{"at_s": 1, "fault": "silence"}]
    with pytest.raises(InputError, match="this one is real"):
        acquisition.station(simulated=False, buses=buses, chamber=chamber, faults=faults)


def test_every_fault_of_a_run_stands_in_its_events_and_its_report(tmp_path):
    faults = [{"at_s": 20, "fault": "silence", "for_s": 3}, {"at_s": 40, "on": "can0", "fault": "loss", "for_s": 1}]
    result = run_job(acquisition.job(tmp_path, settings=acquisition.station(faults=faults)))
    told = [event["text"] for event in result.run.events() if event["kind"] == "rehearsal"]
    assert told == ["chamber: silence begins", "chamber: silence ends", "can0: loss begins", "can0: loss ends"]
    answer = bench("report", result.run.path, "--model", "polynomial")
    assert answer.exit_code in (0, 1), answer.stderr
    assert "chamber: silence begins" in (result.run.path / "report.html").read_text()


def test_faults_of_a_unit_that_is_not_in_the_run_do_nothing(tmp_path):
    content = yaml.safe_load(FOUR.read_text())
    content["faults"] = [{"at_s": 5, "on": "SIM-0002", "fault": "silence"}]
    job = acquisition.job(tmp_path, settings=acquisition.station(**content))
    from dataclasses import replace

    assert run_job(replace(job, serials=("SIM-0001",))).error is None


UP_AND_DOWN = """\
name: up and down
segments:
  - {kind: ramp, to_degc: 31, rate_degc_per_min: 3}
  - {kind: soak, duration_min: 1}
  - {kind: ramp, to_degc: 24, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 1}
"""


@pytest.mark.slow
def test_four_units_of_which_one_dies_in_mid_ramp_with_one_command(tmp_path):
    content = yaml.safe_load(FOUR.read_text())
    content["faults"] = [{"at_s": 100, "on": "SIM-0003", "fault": "silence"}]
    station, profile = tmp_path / "station.yaml", tmp_path / "profile.yaml"
    station.write_text(yaml.safe_dump(content))
    profile.write_text(UP_AND_DOWN)
    command = ["run", profile, "--station", station, "--out", tmp_path, "--model", "polynomial", "--json", "--quiet"]
    answer = bench(*command)
    assert answer.exit_code == 4
    units = json.loads(answer.stdout)["units"]
    assert [unit["unit"] for unit in units] == SERIALS
    calibrated = [
        unit["unit"]
        for unit in units
        if unit["complete"] and json.loads((Path(unit["run"]) / "calibration.json").read_text())["calibration"]
    ]
    assert calibrated == ["SIM-0001", "SIM-0002", "SIM-0004"]
    assert [unit["error"] for unit in units if unit.get("error")] == [
        "dropped: no sound rate frame for 5.0 s, 5 s allowed"
    ]


def test_the_names_of_places_are_those_of_the_wires():
    assert {"delay", "door", "restart"} <= OF_CHAMBER.keys()
    assert "echo" not in OF_CHAMBER
    assert {"bus_off"} == OF_BUS.keys() - OF_UNIT.keys()
