"""A chamber and two gyros that no code of the project knows: from files alone to calibrated and certified units."""

import random
import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import bench
from bench.acquisition import run_job
from bench.base import DPH_PER_DPS
from bench.cli import main
from bench.commands import Task, job_of
from tests.support.commands import undiagnosed

pytest_plugins = ["bench.testing.plugin"]
STATION = Path(__file__).parent / "newcomer" / "station.yaml"
NOISE = random.Random(1)
PROFILE = """
name: brief_calibration
start: {temperature_degc: 25}
settle: {dwell_min: 1, slope_degc_per_min: 0.2}
rates: {heating_degc_per_min: 4, cooling_degc_per_min: 2}
segments:
  - {kind: ramp, to_degc: 40, rate_degc_per_min: 4}
  - {kind: soak, duration_min: 2}
  - {kind: ramp, to_degc: 10, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 2}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 4}
  - {kind: soak, duration_min: 12}
  - {kind: ramp, to_degc: 10, rate_degc_per_min: 1.5}
  - {kind: soak, duration_min: 2}
  - {kind: ramp, to_degc: 40, rate_degc_per_min: 3}
  - {kind: ramp, to_degc: 20, rate_degc_per_min: 2}
  - {kind: ramp, to_degc: 30, rate_degc_per_min: 2}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 10}
"""
MODEL = "name: polynomial\neffects:\n  - polynomial: {order: 3}\n"


def bias_dps(axis: int, degc: float) -> float:
    return 1e-3 * (axis + 1) + 2e-4 * (axis + 1) * (degc - 25) + 1e-6 * (degc - 25) ** 2


def three_axes(moment):
    degc = moment.temperature_degc
    for axis in range(3):
        rate = round((bias_dps(axis, degc) + NOISE.gauss(0, 1e-3)) / 0.00002)
        yield 768, bytes([axis]) + rate.to_bytes(3, "big", signed=True) + struct.pack(">hH", round(100 * degc), 0)


def on_a_line(moment):
    degc = moment.temperature_degc
    rate = round(1e6 * (bias_dps(0, degc) + NOISE.gauss(0, 1e-3)))
    yield 0, struct.pack(">ihH", rate, round(100 * degc), 0)  # the last two bytes are the CRC's


def told(*arguments: object) -> str:
    answer = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert answer.exit_code == 0, answer.output
    return answer.output


@pytest.mark.slow
def test_the_newcomers_units_are_calibrated_exported_and_certified(tmp_path):
    profile = tmp_path / "profile.yaml"
    profile.write_text(PROFILE)
    texts = {"model.yaml": MODEL}
    senders = {"AXES-1": three_axes, "LINE-2": on_a_line}
    ended = run_job(job_of(profile, STATION, Task((), texts, tmp_path, senders=senders)))
    assert ended.error is None
    for unit in ended.units:
        losses = unit.run.manifest().losses
        assert {name for name, count in losses.items() if count} == {"received"}
    axes, line = (unit.run.path for unit in ended.units)
    told("report", line, "--model", "polynomial")
    with undiagnosed():  # that of one unit tells enough, and these are three more
        told("report", axes, "--model", "polynomial")
    runs = [axes.with_name(f"{axes.name}_rate_{axis}") for axis in "xyz"]
    for axis, folder in [*enumerate(runs), (0, line)]:
        at = np.array([12.0, 25.0, 38.0])
        truth = np.array([bias_dps(axis, degc) for degc in at]) * DPH_PER_DPS
        assert bench.open(folder).fit("polynomial").predict(temperature=at).bias == pytest.approx(truth, abs=0.3)
    for folder in (*runs, line):
        told("export", folder, "--format", "csv")
        told("certificate", folder)
        assert (folder / "certificate.pdf").read_bytes().startswith(b"%PDF")


def test_an_alarm_bit_of_the_newcomers_chamber_ends_a_run(bench_station):
    ended = bench_station(chamber=STATION.with_name("chamber.yaml"), faults=[{"fault": "alarm", "at_s": 5}]).run()
    assert (ended.state, ended.exit_code) == ("aborted", 3)
    assert "chamber alarm" in ended.cause
