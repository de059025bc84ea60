"""The rate table in profiles, stations and runs: what turns, what is recorded, and that it stops."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import bench.acquisition.run.runner
import bench.acquisition.station.rate_table
from bench.acquisition.profile import preflight
from bench.acquisition.profile.legs import Leg
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.runner import Job, run_job
from bench.acquisition.station.rate_table import halt
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.station import open_station
from bench.acquisition.station.turning import Turntable
from bench.base import config
from bench.base.errors import EquipmentError, InputError
from bench.record.reading import load
from bench.record.samples import read_samples
from drivers.clock import SimClock
from drivers.errors import DriverError, LinkError
from drivers.rate_table import TableLimits, table_array
from drivers.sim.cia402_table import SimulatedTable
from tests.support import acquisition

STATION = Path(__file__).parents[2] / "profiles" / "stations" / "rate_table.yaml"
RATES = """\
name: rates
segments:
  - {kind: soak, duration_min: 1}
  - {kind: rate, rates_dps: [20, 60, 100], dwell_s: 40}
  - {kind: soak, duration_min: 1}
"""
SCALE_PPM, LINEAR_PPM = 300.0, 80.0


def content(**changes):
    return json.loads(json.dumps(dict(config.read_yaml(STATION).content) | changes))


def station(unit=None, **changes):
    """The shipped station; `unit` is the simulation of its unit."""
    fields = content(**changes)
    if unit is not None:
        fields["units"][0]["simulation"] = unit
    return config.load_config(config.parse_yaml(json.dumps(fields), "station.yaml"), StationSettings)


def job(out, text, settings=None):
    return Job(
        profile_from_text(text),
        text,
        settings or station(),
        json.dumps(content()),
        {"model.yaml": "name: m\n"},
        out=out,
    )


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """A finished run of a unit whose scale factor is off by 300 ppm per 10 degC and 80 ppm per 100 deg/s."""
    unit = {
        "truth": [
            {"mechanism": "static_bias", "coefficients_dph": [5.0]},
            # Constant at a standing temperature: 30 ppm/degC, 10 degC away from its reference.
            {
                "mechanism": "scale_factor_temperature",
                "ppm_per_degc": 30.0,
                "ppb_per_degc2": 0.0,
                "reference_degc": 0.0,
            },
            {"mechanism": "scale_factor_nonlinearity", "linear_ppm": LINEAR_PPM, "square_ppm": 0.0},
        ],
        "noise": {"angle_random_walk": 0.01, "bias_instability": 0.0, "rate_random_walk": 0.0},
    }
    result = run_job(job(tmp_path_factory.mktemp("turned"), RATES, station(unit)))
    assert result.error is None
    return result.run


# ---- profiles --------------------------------------------------------------------------------------------------------


def test_a_rate_segment_turns_each_rate_both_ways_at_each_temperature():
    legs = profile_from_text(
        "name: p\nsegments:\n  - {kind: rate, temperatures_degc: [25, 50], rates_dps: [0, 10], dwell_s: 60}\n"
        "  - {kind: soak, duration_min: 1}\n"
    ).legs()
    assert [(leg.kind, leg.target_degc, leg.turn_dps) for leg in legs] == [
        ("step", 25, 0), ("rate", 25, 0), ("rate", 25, 10), ("rate", 25, -10),
        ("step", 50, 0), ("rate", 50, 0), ("rate", 50, 10), ("rate", 50, -10),
        ("soak", 50, 0),
    ]  # fmt: skip
    assert len({leg.name for leg in legs}) == len(legs)
    assert legs[2].duration_s == 60


def test_ramps_soaks_and_steps_may_turn_meanwhile():
    legs = profile_from_text(
        "name: p\nsegments:\n  - {kind: ramp, to_degc: 30, rate_degc_per_min: 1, turn_dps: 10}\n"
        "  - {kind: step, temperatures_degc: [40], turn_dps: -10}\n  - {kind: soak, duration_min: 1, turn_dps: 5}\n"
    ).legs()
    assert [leg.turn_dps for leg in legs] == [10, -10, -10, 5]


def test_settle_without_a_temperature_is_refused():
    with pytest.raises(InputError, match="has no effect without `temperatures_degc`"):
        profile_from_text("name: p\nsegments:\n  - {kind: rate, rates_dps: [1], dwell_s: 9, settle: {dwell_min: 1}}\n")


def test_a_rate_without_a_table_is_refused_with_its_line():
    found = preflight.check_profile(profile_from_text(RATES, "p.yaml"), acquisition.station().limits())
    with pytest.raises(InputError, match=r"turns a rate table, but the station has none"):
        preflight.refuse_errors(found)
    assert [f.line for f in found if f.level == "error"] == [4]


def test_a_rate_beyond_the_table_is_refused_with_its_line(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(RATES.replace("100]", "300]"))
    from bench.acquisition.profile import profile

    with pytest.raises(InputError, match=r"p\.yaml:4: .*300 deg/s is outside the rate table's limits, \+-200"):
        preflight.refuse_errors(preflight.check_profile(profile.load_profile(path), station().limits()))


def test_turning_one_way_only_is_warned_of():
    text = "name: p\nsegments:\n  - {kind: rate, rates_dps: [10], dwell_s: 9, both_directions: false}\n"
    found = preflight.check_profile(profile_from_text(text), station().limits())
    assert any("no negative rates" in finding.text for finding in found)


# ---- station files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bus": "can7"}, "bus 'can7' is not in this station"),
        ({"bus": "can0"}, "give the table a bus of its own"),
        ({"bus": None}, "a table with driver cia402 needs bus"),
        ({"driver": "aerosmith"}, "needs port"),
        ({"driver": "aerosmith", "port": "/dev/ttyUSB0"}, "a simulated station has a table with driver cia402"),
        ({"highest_dps": 0}, "greater than 0"),
        ({"speed": 3}, "speed"),
    ],
)
def test_what_cannot_work_is_refused_in_the_station_file(change, message):
    with pytest.raises(InputError, match=message):
        station(rate_table=content()["rate_table"] | change)


def test_a_node_that_does_not_answer_stops_the_run_before_anything_moves(tmp_path, monkeypatch):
    monkeypatch.setattr(SimulatedTable, "_read", lambda self, **_: 1 / 0)
    with pytest.raises(DriverError, match="rate table node 5"):
        run_job(job(tmp_path, RATES))


# ---- runs ------------------------------------------------------------------------------------------------------------


def test_the_scale_factor_of_the_unit_comes_out_to_the_noise(turned):
    record = load(turned.path, 10.0)
    applied, degc = record.channel("applied_rate"), record.channel("temperature")
    columns = 3600e-6 * np.column_stack([1e6 / 3600 * np.ones(len(record)), applied, applied * np.abs(applied) / 100])
    beta, *_ = np.linalg.lstsq(columns, record.bias, rcond=None)
    sigma_dph = 0.01 * 60 / np.sqrt(10 / 3600) / 60  # 0.01 deg/sqrt(h) over 10 s
    error = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns))) * sigma_dph
    truth = np.array([5.0, 30.0 * float(np.mean(degc)), LINEAR_PPM])
    assert np.all(np.abs(beta - truth) < 5 * error + [0.0, 0.3, 0.0])  # 0.01 degC of the sensor is 0.3 ppm
    assert error[1] < 1.0


def test_the_table_is_recorded_from_its_encoder(turned):
    time, applied = read_samples(turned.path / "data.parquet", "time", "applied_rate").values()
    known = np.isfinite(applied)
    assert np.median(np.diff(time[known])) == pytest.approx(0.02, abs=1e-6)  # gaps between: nothing is filled
    segments = {s.name: s for s in turned.manifest().segments}
    for rate in (20.0, -60.0, 100.0):
        segment = segments[f"rate {rate:+g} deg/s at 23"]
        inside = known & (time > segment.to_s - 30) & (time < segment.to_s)
        assert np.mean(applied[inside]) == pytest.approx(rate, abs=0.001)
        assert segment.outcome == "done"
        assert segment.to_s - segment.from_s >= 40 + abs(rate) / 50


def test_seconds_of_acceleration_are_left_out_of_a_dataset(turned):
    record = load(turned.path, 1.0)
    known = np.isfinite(record.bias)
    applied = record.channel("applied_rate")[known]
    columns = np.column_stack([np.ones(len(applied)), applied, applied * np.abs(applied)])
    beta, *_ = np.linalg.lstsq(columns, record.bias[known], rcond=None)
    residual = record.bias[known] - columns @ beta
    assert np.max(np.abs(residual)) < 4.0  # a millisecond between the clocks at 50 deg/s^2 would be 180 deg/h
    means = pq.read_table(turned.path / "means.parquet")
    assert 0 < len(means) - len(record) < 60


def test_a_run_ends_with_the_table_standing_and_verified(turned):
    events = [json.loads(line) for line in (turned.path / "events.jsonl").read_text().splitlines()]
    safe = [event["text"] for event in events if event["kind"] == "safe_state"]
    assert safe[0].startswith("rate table quick stop: state quick stop active")
    assert safe[1].startswith("rate table stands: encoder reads")
    assert "set point" in " ".join(safe[3:])  # the chamber after it
    told = [event["rate_dps"] for event in events if event["kind"] == "rate_table" and "rate_dps" in event]
    assert told == [20, -20, 60, -60, 100, -100, 0]


def test_an_abort_in_mid_turn_is_a_quick_stop(tmp_path):
    worst, opened = [], []

    def onlooker(open_now, status):
        opened.append(open_now.turntable)
        if status.leg.kind == "rate" and open_now.turntable.rate_dps > 15:
            worst.append(open_now.turntable.rate_dps)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(job(tmp_path, RATES), onlooker)
    assert worst
    assert not opened[-1].table.enabled
    (events,) = tmp_path.glob("*/*/events.jsonl")
    safe = [json.loads(line) for line in events.read_text().splitlines() if '"safe_state"' in line]
    assert safe[0]["text"].startswith("rate table quick stop")
    assert all(event["ok"] for event in safe)


def test_a_fault_of_the_drive_ends_the_run_and_is_named(tmp_path, monkeypatch):
    class Failing(SimulatedTable):
        def advance(self, t0_s, t1_s):
            if self.rate_dps > 15:
                self.fail(0x8611)
            return super().advance(t0_s, t1_s)

    monkeypatch.setattr(bench.acquisition.station.rate_table, "SimulatedTable", Failing)
    result = run_job(job(tmp_path, RATES))
    assert isinstance(result.error, EquipmentError)
    assert "drive fault 0x8611" in str(result.error)
    assert result.error.exit_code == 4


def test_a_hold_brings_the_table_to_a_stand_and_the_resumed_segment_turns_again(tmp_path, monkeypatch):
    made, held_dps = [], []

    class Sequencer(bench.acquisition.run.runner.Sequencer):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(self)

    def onlooker(open_now, status):
        (sequencer,) = made
        if status.leg.kind == "rate" and status.leg.turn_dps > 0 and not held_dps:
            if open_now.turntable.rate_dps > 15:
                sequencer.request_hold("test")
                held_dps.append(open_now.turntable.rate_dps)
        elif status.state == "holding":
            held_dps.append(open_now.turntable.rate_dps)
            if len(held_dps) == 10:
                sequencer.request_resume("test")

    monkeypatch.setattr(bench.acquisition.run.runner, "Sequencer", Sequencer)
    result = run_job(job(tmp_path, RATES.replace("[20, 60, 100]", "[20]")), onlooker)
    assert result.error is None
    assert held_dps[0] > 15
    assert held_dps[-1] == pytest.approx(0.0, abs=0.01)
    segments = {s.name: s for s in result.run.manifest().segments}
    assert segments["rate +20 deg/s at 23"].outcome == "held"
    resumed = segments["rate +20 deg/s at 23 (resumed)"]
    assert resumed.outcome == "done"
    assert resumed.to_s - resumed.from_s >= 40
    record = load(result.run.path, 1.0)
    inside = (record.time > resumed.to_s - 30) & (record.time < resumed.to_s)
    assert np.mean(record.channel("applied_rate")[inside]) == pytest.approx(20.0, abs=0.001)


def test_a_profile_that_turns_nothing_leaves_the_axis_off(tmp_path):
    opened = []
    text = "name: still\nsegments:\n  - {kind: soak, duration_min: 0.5}\n"
    result = run_job(job(tmp_path, text), lambda open_now, status: opened.append(open_now.turntable.table.enabled))
    assert result.error is None
    assert not any(opened)
    record = load(result.run.path, 1.0)
    assert np.nanmax(np.abs(record.channel("applied_rate"))) < 0.001


# ---- the turntable by itself -----------------------------------------------------------------------------------------


class FakeTable:
    """A table that turns as it is told, or as `rate_dps` says."""

    limits = TableLimits(100.0, 50.0)

    def __init__(self, clock):
        self.clock, self.enabled, self.commanded_dps, self.rate_dps = clock, False, 0.0, None
        self.silent = False

    def prepare(self):
        return ()

    def enable(self):
        self.enabled = True

    def set_rate(self, rate_dps, accel_dps2=None):
        self.commanded_dps = rate_dps

    def poll(self):
        if self.silent:
            raise LinkError("rate table node 5: no answer")
        rate = self.commanded_dps if self.rate_dps is None else self.rate_dps
        return table_array([(self.clock.now(), rate, 0.0)])


def leg(turn_dps, kind="rate", duration_s=5.0):
    return Leg(0, "a leg", kind, 23.0, 23.0, 100.0, 0.0, 5.0, duration_s=duration_s, turn_dps=turn_dps)


class Told:
    """Keeps what a run would record."""

    def __init__(self):
        self.events = []

    def event(self, kind, text, **facts):
        self.events.append((text, facts))

    def table(self, readings):
        pass


@pytest.fixture
def turntable():
    clock = SimClock()
    return Turntable(FakeTable(clock), clock, 0.05, Told())


def live(turntable, seconds):
    for _ in range(seconds):
        turntable._clock.sleep_until(turntable._clock.now() + 1)
        turntable.poll()


def test_the_dwell_counts_from_when_the_table_has_got_there(turntable):
    turning = turntable.begin(leg(30.0))
    turntable.table.rate_dps = 12.0  # still accelerating
    live(turntable, 20)
    assert not turning.tick(turntable._clock.now(), True)
    turntable.table.rate_dps = None
    live(turntable, 5)
    assert not turning.tick(turntable._clock.now(), True)
    live(turntable, 1)
    assert turning.tick(turntable._clock.now(), True)


def test_without_a_leg_the_table_comes_to_a_stand_and_goes_on_with_the_next(turntable):
    turntable.begin(leg(30.0)).stop()
    live(turntable, 1)  # a hold
    assert turntable.table.commanded_dps == 0.0
    turntable.begin(leg(30.0))
    assert turntable.table.commanded_dps == 30.0


def test_from_leg_to_leg_at_one_rate_nothing_is_commanded(turntable):
    turntable.begin(leg(30.0)).stop()
    turntable.begin(leg(30.0, "soak"))
    live(turntable, 2)
    assert [facts.get("rate_dps") for _, facts in turntable._journal.events] == [None, 30.0]


def test_a_table_that_never_gets_there_or_leaves_its_rate_has_failed(turntable):
    turntable.begin(leg(30.0))
    turntable.table.rate_dps = 29.0
    with pytest.raises(EquipmentError, match=r"turns 29\.000 deg/s, commanded 30"):
        live(turntable, 40)


def test_a_silent_table_ends_the_run_only_while_its_axis_is_on(turntable):
    turntable.table.silent = True
    live(turntable, 3)
    turntable.table.silent = False
    live(turntable, 3)
    assert [text[:24] for text, _ in turntable._journal.events] == [
        "rate table does not answ",
        "rate table answers again",
    ]
    turntable.begin(leg(30.0))
    turntable.table.silent = True
    with pytest.raises(LinkError):
        live(turntable, 1)


def test_a_table_that_leaves_its_rate_has_failed(turntable):
    turntable.begin(leg(30.0))
    live(turntable, 3)
    turntable.table.rate_dps = 20.0
    with pytest.raises(EquipmentError, match="has left its rate"):
        live(turntable, 5)


# ---- on wall time, over a real wire ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_table_of_another_process_is_turned_and_halted_from_outside():
    """`bench sim` on one side, a real station on the other; the watchdog's way to stop it."""
    with acquisition.elsewhere(station()) as served:
        text = served.station_yaml()
        settings = config.load_config(config.parse_yaml(text, "remote.yaml"), StationSettings)
        with open_station(settings, settings.units) as opened:
            opened.turntable.begin(leg(20.0))
            while opened.turntable.arrived_s() is None:
                opened.clock.sleep_until(opened.clock.now() + 0.1)
                opened.turntable.poll()
            assert opened.turntable.rate_dps == pytest.approx(20.0, abs=0.1)
            assert served.station.table.rate_dps == pytest.approx(20.0, abs=0.1)
        steps = halt(settings)  # the bench is gone, the axis is not
        assert [step.ok for step in steps] == [True, True, True]
        assert served.station.table.rate_dps == pytest.approx(0.0, abs=0.1)


def test_a_table_that_cannot_be_reached_is_said():
    settings = station()
    fields = settings.model_dump(mode="json", exclude_defaults=True) | {"simulated": False, "instruments": []}
    fields["chamber"]["connection"] = {"url": "tcp://127.0.0.1:1"}
    fields["buses"] = {name: {"interface": "loopcan", "channel": "1"} for name in fields["buses"]}
    (step,) = halt(config.load_config(config.parse_yaml(json.dumps(fields), "s.yaml"), StationSettings))
    assert not step.ok
    assert "press its emergency stop" in step.detail


def test_a_station_without_a_table_has_nothing_to_halt():
    assert halt(acquisition.station()) == []


# ---- what is wrong with a simulated table, and with a unit's clock ---------------------------------------------------


SILENT = {"truth": [], "noise": {"angle_random_walk": 0.0, "bias_instability": 0.0, "rate_random_walk": 0.0}}


@pytest.mark.slow
def test_a_table_whose_encoder_counts_too_much_makes_the_unit_look_too_small(tmp_path):
    """The truth is the ratio of two angles, which no part of the bench computes."""
    table = {**content()["rate_table"], "simulation": {"scale_error_ppm": 200.0}}
    run = run_job(job(tmp_path, RATES, station(SILENT, rate_table=table))).run
    data = pq.read_table(run.means).to_pandas().dropna(subset=["rate", "applied_rate"])
    steady = data[data["applied_rate"].diff().abs().lt(0.01) & data["applied_rate"].abs().gt(50)]
    ratio = (steady["rate"] / 3600.0 / steady["applied_rate"]).mean()
    assert ratio == pytest.approx(1.0 / (1.0 + 200e-6), abs=5e-6)


@pytest.mark.slow
def test_a_unit_whose_clock_is_slow_sends_fewer_samples_and_its_drift_is_found(tmp_path):
    text = "name: still\nsegments:\n  - {kind: soak, duration_min: 3}\n"
    run = run_job(job(tmp_path, text, station({**SILENT, "clock_ppm": 400.0}))).run
    manifest = run.manifest()
    assert manifest.unit_clock.drift_ppm == pytest.approx(400.0, abs=5.0)
    assert manifest.losses["lost"] == 0
    data = read_samples(run.data, "time", "rate")
    assert np.diff(data["time"][np.isfinite(data["rate"])]).mean() == pytest.approx(0.002 * 1.0004, rel=1e-6)


def test_a_real_table_has_no_simulated_error():
    table = {**content()["rate_table"], "simulation": {"scale_error_ppm": 1.0}}
    chamber = {"connection": {"url": "tcp://127.0.0.1:1"}, **content()["chamber"]}
    buses = {name: {"interface": "socketcan", "channel": name} for name in content()["buses"]}
    with pytest.raises(InputError, match="only a simulated table has it"):
        station(rate_table=table, simulated=False, chamber=chamber, buses=buses)
