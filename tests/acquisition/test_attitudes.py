"""Attitudes: a profile names them, a fixture takes the units there, gravity is looked at, and the run remembers."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.acquisition.profile.preflight import check_profile
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.continuation import plan, remaining
from bench.acquisition.run.control import Desk
from bench.acquisition.run.rehearsal import rehearse
from bench.acquisition.run.runner import run_job
from bench.acquisition.station.fixture import LOOK_S, Fixture
from bench.acquisition.station.settings.fixture import FixtureSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.base import Document, InputError, load_config, parse_yaml, read_yaml
from bench.record import ATTITUDES, ExecutedSegment, RunFolder, seconds_of
from bench.record.samples import read_samples
from drivers.clock import SimClock
from tests.support import acquisition

SHIPPED = Path(__file__).parents[2] / "profiles" / "stations" / "imu.yaml"
OVER = """\
name: over
settle: {unit_band_degc: 15, slope_degc_per_min: 2, dwell_min: 0.2}
segments:
  - {kind: soak, duration_min: 0.2, attitude: x_up}
  - {kind: soak, duration_min: 0.1}
  - {kind: tumble, attitudes: [x_up, -x-y_up], dwell_min: 0.2}
  - {kind: rate, rates_dps: [30], dwell_s: 10}
  - {kind: tumble, attitudes: [z_up], dwell_min: 0.5, to_degc: 23.4}
"""


def station(**fixture):
    content = dict(read_yaml(SHIPPED).content)
    content["fixture"] = {"attitudes": 24, "operator": "simulated", "takes_s": 5} | fixture
    return load_config(parse_yaml(json.dumps(content), "station.yaml"), StationSettings)


def attitude_events(run):
    events = [json.loads(line) for line in (run.path / "events.jsonl").read_text().splitlines()]
    return [event for event in events if event["kind"] == "attitude"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The second change is forgotten at first."""
    result = run_job(acquisition.job(tmp_path_factory.mktemp("over"), OVER, station(forgets=[2])))
    assert result.error is None
    return result.run


def test_an_attitude_stays_until_another_one_is_named():
    legs = profile_from_text(OVER).legs()
    assert [leg.attitude for leg in legs] == ["x_up"] * 3 + ["-x-y_up"] * 3 + ["z_up"]


def test_rates_are_turned_in_each_attitude_at_each_temperature():
    segment = "{kind: rate, rates_dps: [30], dwell_s: 9, attitudes: [x_up, z_up], temperatures_degc: [20, 25]}"
    legs = profile_from_text(f"name: rates\nsegments:\n  - {segment}\n").legs()
    turned = [(leg.target_degc, leg.attitude, leg.turn_dps) for leg in legs if leg.kind == "rate"]
    assert turned == [(t, a, w) for t in (20, 25) for a in ("x_up", "z_up") for w in (30, -30)]


def test_a_tumble_throughout_a_ramp_divides_it_evenly():
    text = """\
name: slow
start: {temperature_degc: 20, attitude: z_up}
segments:
  - {kind: tumble, attitudes: 6, dwell_min: 2, to_degc: 32}
"""
    settled, *parts = profile_from_text(text).legs()
    assert settled.attitude == "z_up"
    assert [leg.target_degc for leg in parts] == [22, 24, 26, 28, 30, 32]
    assert {leg.rate_degc_per_min for leg in parts} == {1.0}
    assert [leg.attitude for leg in parts] == ["x_up", "x_down", "y_up", "y_down", "z_up", "z_down"]


@pytest.mark.parametrize(
    ("segment", "said"),
    [
        ("{kind: soak, duration_min: 1, attitude: x_upp}", "attitude 'x_upp' is not known; did you mean 'x_up'"),
        ("{kind: tumble, attitudes: 7, dwell_min: 1}", "attitudes"),
        ("{kind: tumble, attitudes: [z_up, up], dwell_min: 1}", "attitude 'up' is not known"),
    ],
)
def test_an_attitude_that_has_no_such_name_is_refused_at_its_line(segment, said):
    with pytest.raises(InputError, match=r"profile:3: .*") as error:
        profile_from_text(f"name: wrong\nsegments:\n  - {segment}\n")
    assert said in str(error.value)


def test_a_check_refuses_what_the_station_does_not_reach_and_counts_the_changes():
    profile = profile_from_text(OVER, "over.yaml")
    findings = check_profile(profile, station().limits())
    assert not [one for one in findings if one.level == "error"]
    assert any("3 changes of position by the operator (3 attitudes), 5 s each" in one.text for one in findings)
    (error,) = [one for one in check_profile(profile, station(attitudes=6).limits()) if one.level == "error"]
    assert str(error).startswith(
        "over.yaml:6: error: tumble: -x-y_up: the station's fixture does not reach -x-y_up; it"
    )
    findings = check_profile(profile, acquisition.station().limits())
    assert any("attitude x_up, but the station has no fixture" in one.text for one in findings if one.level == "error")


def test_a_rehearsal_counts_the_time_of_the_changes():
    segments = rehearse(profile_from_text(OVER), station(takes_s=100))
    assert segments[3].from_s - segments[2].to_s == pytest.approx(100 + LOOK_S, abs=2)


def test_a_simulated_operator_is_refused_on_a_real_station():
    content = dict(read_yaml(SHIPPED).content) | {"simulated": False}
    content["chamber"] = content["chamber"] | {"connection": {"url": "tcp://127.0.0.1:5020"}}
    content["buses"] = {name: {"interface": "socketcan", "channel": name} for name in content["buses"]}
    with pytest.raises(InputError, match="a simulated operator turns only a simulated fixture"):
        load_config(parse_yaml(json.dumps(content), "station.yaml"), StationSettings)


def test_a_run_says_which_attitude_the_unit_had_when(run):
    segments = run.manifest().segments
    assert [one.attitude for one in segments] == ["x_up"] * 3 + ["-x-y_up"] * 3 + ["z_up"]
    assert run.manifest().latitude_deg == 45.0
    data, gravity = seconds_of(run.path), 9.80620
    for segment in segments[:4]:
        inside = (data.time > segment.from_s + 1) & (data.time < segment.to_s - 1)
        seen = [np.nanmean(data.channels[f"acceleration_{axis}"][inside]) for axis in "xyz"]
        assert seen == pytest.approx(gravity * ATTITUDES[segment.attitude].matrix[:, 2], abs=0.3)


def test_each_attitude_of_a_tumble_is_kept_for_its_dwell(run):
    last = run.manifest().segments[-1]
    assert last.to_s - last.from_s >= 30.0


def test_an_attitude_that_gravity_contradicts_holds_the_run(run):
    first, wrong, right, _ = attitude_events(run)
    assert (first["attitude"], first["who"]) == ("x_up", "the simulated operator")
    assert first["off_deg"]["IMU-0001"] < 2
    assert wrong["text"] == "gravity of unit IMU-0001, 135 deg from where -x-y_up has it, as in x_up"
    assert right["attitude"] == "-x-y_up"
    assert right["t_s"] - wrong["t_s"] >= 5


def test_the_units_on_the_wire_follow_table_and_attitude(run):
    data = read_samples(run.data)
    plus = run.manifest().segments[4]
    inside = (data["time"] > plus.to_s - 8) & (data["time"] < plus.to_s - 1)
    rate = np.array([np.nanmean(data[f"rate_{axis}"][inside]) for axis in "xyz"]) / 3600
    assert np.nanmean(data["applied_rate"][inside]) == pytest.approx(30, abs=0.01)
    assert rate == pytest.approx(30 * ATTITUDES["-x-y_up"].matrix[:, 2], abs=0.3)


def test_people_are_asked_and_go_on(tmp_path):
    desk, asked = Desk(), []

    def answer(station, status):
        question = next((text for text in status.holding if "to be turned to" in text), "")
        if question and question not in asked:
            asked.append(question)
            desk.ask("resume", "somebody")

    result = run_job(acquisition.job(tmp_path, OVER, station(operator="asked")), answer, desk)
    assert result.error is None
    assert asked == [
        f"the fixture, to be turned to {name}: confirm by going on" for name in ("x_up", "-x-y_up", "z_up")
    ]
    assert [event["who"] for event in attitude_events(result.run)] == ["somebody"] * 3


class Journal:
    """Keeps the events."""

    def __init__(self):
        self.said = []

    def event(self, kind, text, **facts):
        self.said.append(text)


class Unit:
    """A unit whose x and y are swapped."""

    serial = "U"

    def force(self):
        return np.array([0.1, 9.8, 0.0])


def test_who_confirms_the_same_twice_is_believed():
    clock, journal = SimClock(), Journal()
    fixture = Fixture(FixtureSettings(attitudes=6), clock, journal, [Unit()])
    fixture.ask("x_up")
    for time in (5.0, 10.0):
        assert fixture.attitude is None
        fixture.confirm("me")
        clock.sleep_until(time)
        fixture.tick()
        if time == 5.0:
            assert "as in y_up" in fixture.waiting
            assert "go on to measure as it is" in fixture.waiting
    assert fixture.attitude == "x_up"
    assert fixture.waiting == ""


TURN = """\
import sys
name, matrix = sys.argv[1:]
open("turned.txt", "a").write(f"{name} {matrix.count(',')}\\n")
sys.exit("no air pressure" if name == "-x-y_up" else 0)
"""


def test_a_program_turns_the_fixture_and_people_are_asked_where_it_fails(tmp_path):
    (tmp_path / "turn.py").write_text(TURN)
    own = station(operator="asked", turn=[sys.executable, "turn.py", "{attitude}", "{matrix}"])
    own = own.beside(Document(str(tmp_path / "station.yaml"), {}, {}))
    desk, asked = Desk(), set()

    def answer(station, status):
        question = next((text for text in status.holding if "turn the fixture and go on" in text), "")
        if question and not asked:
            asked.add(question)
            desk.ask("resume", "somebody")

    result = run_job(acquisition.job(tmp_path / "out", OVER, own), answer, desk)
    assert result.error is None
    assert (tmp_path / "turned.txt").read_text() == "x_up 8\n-x-y_up 8\nz_up 8\n"
    who = [event.get("who") for event in attitude_events(result.run)]
    assert who == ["the fixture's program", None, "somebody", "the fixture's program"]
    assert "ended with 1: no air pressure" in attitude_events(result.run)[1]["text"]
    told = check_profile(profile_from_text(OVER), own.limits())
    assert any("3 changes of position by the fixture's program" in one.text for one in told)


@pytest.mark.parametrize(
    ("program", "said"),
    [
        (["/no/such/program"], "/no/such/program cannot be started in"),
        ([sys.executable, "-c", "import time; time.sleep(600)"], "did not end within 0.01 s"),
    ],
)
def test_a_program_that_does_not_turn_is_told_and_leaves_nothing_behind(program, said, tmp_path):
    settings = FixtureSettings(attitudes=6, turn=tuple(program), timeout_s=0.01).beside(tmp_path)
    journal = Journal()
    fixture = Fixture(settings, SimClock(), journal)
    fixture.ask("x_up")
    started = fixture._program._program
    process = started and started._process
    while "go on to measure as it is" not in fixture.waiting:
        fixture.tick()
    assert said in journal.said[0]
    assert process is None or process.returncode == -9


def test_a_place_that_is_not_known_is_refused():
    with pytest.raises(InputError, match=r"\{angle\} is not known here; allowed: \{attitude\}, \{matrix\}"):
        station(operator="asked", turn=["turn", "{angle}"])


def test_a_run_goes_on_in_the_attitude_in_which_it_was_cut_off(tmp_path):
    desk, settings = Desk(), station()

    def cut(station, status):
        if status.leg.attitude == "-x-y_up" and status.t_s - status.leg_from_s > 3 and status.leg.name != "hold":
            desk.ask("abort", "somebody")

    path = run_job(acquisition.job(tmp_path, OVER, settings), cut, desk).run.path
    profile = profile_from_text(OVER)
    continuation = plan(RunFolder(path), profile, settings)
    result = run_job(replace(acquisition.job(tmp_path, OVER, settings), continuation=continuation,
                             serials=continuation.serials))  # fmt: skip
    assert result.error is None
    assert [one.attitude for one in result.run.manifest().segments] == ["x_up"] * 3 + ["-x-y_up"] * 5 + ["z_up"]
    asked = [event["attitude"] for event in attitude_events(result.run)]
    assert asked == ["x_up", "-x-y_up", "-x-y_up", "z_up"]


def test_a_run_that_is_resumed_asks_for_the_attitude_again():
    profile = profile_from_text(OVER)
    done = [ExecutedSegment(name=leg.name, from_s=0, to_s=12, attitude=leg.attitude) for leg in profile.legs()[:3]]
    back, *legs = remaining(profile, done, 23.0)
    assert [leg.attitude for leg in (back, *legs)] == ["-x-y_up"] * 4 + ["z_up"]
