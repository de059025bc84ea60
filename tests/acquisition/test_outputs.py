"""Units with several outputs in one journal and one run; one output is the case n = 1."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from bench.acquisition.recording.assemble import assemble
from bench.acquisition.run.runner import run_job
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.wires import wire_findings
from bench.base import config
from bench.base.errors import InputError
from bench.commands.acquisition import check
from bench.commands.replay.replaying import replay
from bench.record import RunFolder, apart, faults, read_samples
from bench.record.reading import load, seconds_of
from drivers.journal import Kind, read_blocks
from tests.support import acquisition
from tests.support.commands import bench
from tests.support.shown import outputs, unlike

RATES = ("rate_x", "rate_y", "rate_z")
OUTPUTS = (*RATES, "acceleration_x", "acceleration_y", "acceleration_z")


def imu(number, bus):
    """Six outputs and two thermometers in one frame of 48 bytes with a 29-bit identifier, without a DBC."""
    at = {"id": 0x18FF0200, "type": "signed", "length": 32, "cycle_ms": 2.0}
    rate, force = {"scale": 1e-6, "unit": "deg/s"}, {"scale": 1e-6, "unit": "m/s^2"}
    signals = {name: {**at, **rate, "start": 32 * n} for n, name in enumerate(RATES)}
    signals |= {name: {**at, **force, "start": 96 + 32 * n} for n, name in enumerate(OUTPUTS[3:])}
    warm = {**at, "length": 16, "scale": 0.01, "unit": "degC"}
    signals |= {f"temperature_{n}": {**warm, "start": 176 + 16 * n} for n in (1, 2)}
    signals["counter"] = {"id": at["id"], "start": 224, "length": 16}
    signals["status"] = [{"signal": {"id": at["id"], "start": 240, "length": 2}, "valid": "1"}]
    signals["serial"] = {"id": 0x701, "start": 0, "length": 32, "cycle_ms": 1000.0}
    signals["state"] = {"id": 0x701, "start": 32, "length": 8}
    return {
        "serial": f"IMU-{number}",
        "identity": number + 5,
        "bus": bus,
        "number": number,
        "signals": signals,
    }


def station(units, **bus):
    buses = {name: {"interface": "blocks", "channel": name, "fd": True, **bus} for name in {u["bus"] for u in units}}
    return acquisition.station(buses=buses, units=units)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Four units on two FD buses, half a minute."""
    units = [imu(n, f"can{n // 2}") for n in range(4)]
    text = "name: still\nsegments:\n  - {kind: soak, duration_min: 0.5}\n"
    result = run_job(acquisition.job(tmp_path_factory.mktemp("imu"), text, station(units)))
    assert result.error is None
    return [unit.run for unit in result.units]


def test_a_simulated_unit_sends_as_often_as_its_layout_says(tmp_path):
    at = {"id": 0x120, "type": "signed", "length": 32}
    signals = {
        "rate": {**at, "start": 0, "scale": 1e-6, "unit": "deg/s"},
        "temperature": {**at, "start": 32, "length": 16, "scale": 0.01, "unit": "degC"},
        "counter": {"id": 0x120, "start": 48, "length": 16},
        "cycle_ms": 40,
    }
    noise = {"angle_random_walk": 0.3, "bias_instability": 0.0, "rate_random_walk": 0.0}
    simulation = {"rate": {"truth": [], "noise": noise}}
    unit = {"serial": "SLOW-1", "bus": "can0", "number": 0, "signals": signals, "simulation": simulation}
    text = "name: still\nsegments:\n  - {kind: soak, duration_min: 2}\n"
    result = run_job(acquisition.job(tmp_path, text, station([unit])))
    assert result.error is None
    run = result.run
    data = read_samples(run.data, "time", "rate")
    assert np.diff(data["time"]) == pytest.approx(0.04)
    assert len(data["time"]) == pytest.approx(25 * run.manifest().duration_s, abs=25)
    assert np.nanstd(data["rate"]) == pytest.approx(0.3 * 60 * np.sqrt(25), rel=0.1)  # N in deg/sqrt(h)


def test_six_outputs_of_four_units_on_two_buses_are_captured_whole(runs):
    for run in runs:
        manifest, data = run.manifest(), read_samples(run.data)
        lost = {name: count for name, count in manifest.losses.items() if count and name != "received"}
        assert lost == {}
        for name in OUTPUTS:
            assert np.count_nonzero(np.isfinite(data[name])) >= 15_000
        assert "rate" not in data
        assert manifest.unit_identity.serial == int(manifest.unit[-1]) + 5
    assert (runs[0].journal / "can0.gtbj").samefile(runs[1].journal / "can0.gtbj")


def test_values_are_those_of_the_frames(runs):
    frames = [b.frames() for b in read_blocks(runs[1].journal / "can0.gtbj") if b.kind is Kind.FRAMES]
    rows = np.concatenate([f["data"][f["id"] == 0x18FF0201] for f in frames])
    data = read_samples(runs[1].data)
    for n, name in enumerate(OUTPUTS):
        raw = np.ascontiguousarray(rows[:, 4 * n : 4 * n + 4]).view("<i4")[:, 0]
        values = data[name][np.isfinite(data[name])]
        np.testing.assert_allclose(values[:1000], raw[:1000] * (1e-6 * 3600 if n < 3 else 1e-6), rtol=1e-12)
    assert abs(np.nanmean(data["acceleration_z"]) - 9.80665) < 0.01


def test_a_dataset_gives_its_outputs_by_name(runs):
    whole = seconds_of(runs[0].path)
    assert whole.outputs == OUTPUTS
    assert {"temperature", "temperature_1", "temperature_2"} < set(whole.channels)
    one = load(runs[0].path, 1.0, output="rate_y")
    assert (one.outputs, one.output) == (("rate",), "rate_y")
    rows = np.isin(whole.time, one.time)
    assert np.array_equal(one.channel("rate"), whole.channels["rate_y"][rows], equal_nan=True)
    with pytest.raises(InputError, match="6 outputs; choose one of rate_x, rate_y, rate_z with --output"):
        whole.channel("rate")
    with pytest.raises(InputError, match="'acceleration_x' is not a rate of this unit; choose one of rate_x"):
        whole.of("acceleration_x")


def say(*arguments):
    answer = bench(*arguments)
    return answer.exit_code, answer.stdout + answer.stderr


def test_commands_ask_which_output_and_take_it_by_name(runs):
    code, text = say("noise", runs[0].path)
    assert code == 2
    assert "the unit has 6 outputs; choose one of rate_x, rate_y, rate_z with --output" in text
    for command in (("compare", runs[0].path), ("diagnose", runs[0].path, "--model", "polynomial")):
        assert say(*command)[0] == 2
    assert say("compare", runs[0].path, "--output", "acceleration_x")[0] == 2
    code, text = say("noise", runs[0].path, "--output", "rate_z", "--json")
    assert "6 outputs" not in text


def test_each_rate_is_reported_in_a_run_folder_of_its_own(runs, tmp_path):
    whole = RunFolder(tmp_path / "run")
    shutil.copytree(runs[2].path, whole.path)
    told = json.loads(say("report", whole.path, "--model", "polynomial", "--json")[1])
    assert [(unit["unit"], unit["output"]) for unit in told["units"]] == [("IMU-2", rate) for rate in RATES]
    for rate, unit in zip(RATES, told["units"], strict=True):
        own = RunFolder(Path(unit["run"]))
        assert (own.path.name, Path(unit["report"]).is_file()) == (f"run_{rate}", True)
        mine, theirs = read_samples(own.data), read_samples(whole.data)
        assert np.array_equal(mine["rate"], theirs[rate], equal_nan=True)
        assert not set(OUTPUTS) & set(mine)
        assert np.array_equal(load(own.path).channel("rate"), load(whole.path, output=rate).channel("rate"))
        assert list(faults(own.path)) == []
        assert unit["samples"] == np.count_nonzero(np.isfinite(theirs[rate]))
    assert [path.name for path in apart(whole)[0].path.parent.glob("run*")].count("run_rate_x") == 1
    assert say("report", whole.path, "--model", "polynomial", "--output", "rate_y")[0] in {0, 1}
    assert "is not a rate of this unit" in say("report", whole.path, "--output", "rate")[1]


def test_what_is_delivered_is_of_one_output(runs, tmp_path):
    shutil.copytree(runs[2].path, tmp_path / "run")
    for command in (("export", tmp_path / "run", "--format", "json"), ("certificate", tmp_path / "run")):
        code, text = say(*command)
        assert (code, "choose one of rate_x, rate_y, rate_z with --output" in text) == (2, True)
        assert "choose one of" not in say(*command, "--output", "rate_z")[1]


def test_one_output_is_as_before(short_run):
    dataset = seconds_of(short_run.path)
    assert (dataset.outputs, dataset.output) == (("rate",), "rate")


def test_a_run_with_several_outputs_is_made_again_bit_for_bit(runs, tmp_path):
    found = replay(runs[0].path)
    assert found.identical, (found.tampered, found.differences, found.failed)
    killed = RunFolder(tmp_path / "run")
    shutil.copytree(runs[3].path, killed.path)
    for name in ("manifest.json", "chain.seal", "data.parquet", "means.parquet", "events.jsonl"):
        (killed.path / name).unlink()
    assemble(killed)
    before, after = read_samples(runs[3].data), read_samples(killed.data)
    assert all(np.array_equal(before[name], after[name], equal_nan=True) for name in before)


def test_a_unit_without_thermometer_has_the_air_of_the_chamber(tmp_path):
    unit = imu(0, "can0")
    for name in ("temperature_1", "temperature_2", "serial", "state", "counter", "status"):
        unit["signals"].pop(name)
    unit.pop("identity")
    text = "name: still\nsegments:\n  - {kind: soak, duration_min: 0.2}\n"
    result = run_job(acquisition.job(tmp_path, text, station([unit])))
    assert result.error is None
    data = read_samples(result.run.data)
    assert np.array_equal(data["temperature"], data["chamber_temperature"], equal_nan=True)
    assert seconds_of(result.run.path).of("rate_z").channel("temperature").size
    assert result.run.manifest().losses["lost"] == 0
    assert replay(result.run.path).identical


def findings(units, **bus):
    return [(finding.level, finding.text) for finding in wire_findings(station(units, **bus))]


def test_the_check_says_what_a_unit_lacks_and_how_full_its_bus_is():
    lacking = imu(0, "can0")
    lacking["signals"] = {name: lacking["signals"][name] for name in RATES}
    lacking.pop("identity")
    said = findings([lacking, imu(1, "can0")], bitrate=1_000_000, data_bitrate=8_000_000)
    texts = " | ".join(text for _, text in said)
    assert "unit IMU-0: no counter and no time stamp" in texts
    assert "unit IMU-0: no thermometer: the air of the chamber takes its place" in texts
    [shown] = outputs("docs/howto/equipment.md", "test: tests/acquisition/test_outputs.py")
    assert not unlike(shown, "\n".join(f"{level}: {text}" for level, text in said))
    assert {level for level, _ in said} == {"info"}


def test_a_bus_without_a_bit_rate_says_that_its_load_is_unknown_where_it_may_be_too_much():
    def said(count):
        settings = station([imu(n, "can0") for n in range(count)])
        real = settings.model_copy(update={"buses": {"can0": Bus(interface="socketcan", channel="can0", fd=True)}})
        return [one.text for one in wire_findings(real, [unit.serial for unit in real.units]) if one.level == "warning"]

    (text,) = said(10)
    assert text.startswith("bus can0: its bit rate is not stated, so nobody knows whether all frames fit; at 500000 ")
    assert text.endswith("% of it; state `bitrate`, and `data_bitrate` of CAN FD")
    assert said(1) == []


@pytest.mark.parametrize(
    ("units", "bus", "complaint"),
    [
        ([imu(n, "can0") for n in range(10)], {"bitrate": 500_000}, "more than there is"),
        ([imu(0, "can0")], {"fd": False}, "0x18FF0200 has 32 bytes, bus can0 is classical CAN"),
        ([{**imu(0, "can0"), "signals": {"rate_x": imu(0, "can0")["signals"]["rate_x"]}}], {}, "map `serial`"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_moves(tmp_path, units, bus, complaint):
    settings = station(units, **bus)
    assert any(level == "error" and complaint in text for level, text in findings(units, **bus))
    (tmp_path / "s.yaml").write_text(config.dump(settings.model_dump(mode="json", exclude_defaults=True)))
    (tmp_path / "p.yaml").write_text(acquisition.SHORT)
    with pytest.raises(InputError, match=complaint):
        check(tmp_path / "p.yaml", tmp_path / "s.yaml")


@pytest.mark.parametrize(
    ("signals", "complaint"),
    [
        ({"counter": "Tick"}, "no output: map at least one of rate, rate_x"),
        ({"rate": "A", "rate_x": "B"}, "`rate` is the output of a unit with one axis"),
        ({"rate_x": {"id": 1, "start": 0, "length": 70}}, "length"),
        ({"rate_w": "A"}, "rate_w"),
    ],
)
def test_a_mapping_that_makes_no_sense_is_refused_with_its_place(signals, complaint):
    content = acquisition.station_content(units=[{"serial": "A", "bus": "can0", "signals": signals}])
    with pytest.raises(InputError, match=complaint):
        config.load_config(config.parse_yaml(config.dump(content), "station.yaml"), StationSettings)
