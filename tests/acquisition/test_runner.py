"""Whole runs on the simulated station: what is left behind, and the safe state whatever happens."""

import errno
import os
import resource
import signal
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import bench.acquisition.run.runner
import bench.acquisition.station.simulation
import bench.acquisition.station.stage
from bench.acquisition.profile.guards import GuardSettings
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.run.runner import run_job
from bench.acquisition.run.wiring import Continue, Stop
from bench.base.errors import EquipmentError, InputError, RunAborted
from bench.record import RunFolder, open_run, sha256
from bench.record.samples import read_samples
from drivers.journal import Kind, read_blocks
from drivers.sim.station import SimulatedStation
from tests.support import acquisition
from tests.support.acquisition import at


def raising(error):
    def action(station):
        raise error

    return action


def is_safe(world):
    commands = world[0].chamber.commands()
    return (commands.setpoint, commands.on, commands.ramp_rate_degc_per_min) == (23.0, False, None)


def kinds(run):
    return [event["kind"] for event in run.events()]


def sound_frames(run):
    """Frames in the journal of the bus; every block of which has the right CRC."""
    return np.concatenate([b.frames() for b in read_blocks(run.journal / "can0.gtbj") if b.kind is Kind.FRAMES])


class Enough:
    """Ends a run at a bench time."""

    def decide(self, status):
        return Stop("residual below 0.1 deg/h", who="live fit") if status.t_s >= 30.0 else Continue()


def test_a_run_that_an_analysis_ends_early_is_done_and_says_who_ended_it(tmp_path, world):
    result = run_job(acquisition.job(tmp_path, acquisition.LONG), decider=Enough())
    manifest = result.run.manifest()
    said = "ended early by live fit: residual below 0.1 deg/h"
    assert (result.error, manifest.state, manifest.cause) == (None, "done", said)
    assert [(s.outcome, s.settled, s.reason) for s in manifest.segments] == [("ended", True, said)]
    (event,) = [event for event in result.run.events() if event["kind"] == "decision"]
    assert (event["who"], event["reason"]) == ("live fit", "residual below 0.1 deg/h")
    assert is_safe(world)


def test_a_run_leaves_a_complete_folder(short_run):
    manifest = open_run(short_run.path).manifest()
    assert (manifest.state, manifest.cause, manifest.unit) == ("done", "end of profile", "SIM-0001")
    assert [s.outcome for s in manifest.segments] == ["done", "done"]
    assert all(segment.settled for segment in manifest.segments)
    assert manifest.sample_rate_hz == 500
    assert manifest.rate_step_dph == pytest.approx(0.0036)
    assert manifest.unit_identity.serial == 1
    assert manifest.seeds["station"] == 1
    assert manifest.versions["pymodbus"].startswith("3.16")
    files = {str(p.relative_to(short_run.path)) for p in short_run.path.rglob("*") if p.is_file()}
    assert files == {*manifest.files, "manifest.json", "chain.seal"}
    assert {name: sha256(short_run.path / name) for name in manifest.files} == manifest.files
    assert (short_run.path / "profile.yaml").read_text() == acquisition.SHORT


def test_no_frame_is_lost(short_run):
    manifest = short_run.manifest()
    losses = dict(manifest.losses)
    assert losses.pop("received") == len(sound_frames(short_run)) > 600 * manifest.duration_s
    assert set(losses.values()) == {0}


def test_every_write_and_the_safe_state_are_events(short_run):
    writes = [event["text"] for event in short_run.events() if event["kind"] == "write"]
    assert writes == [
        "mode: off -> auto",
        "ramp_rate: 0.01 -> 2",
        "ramp_action: off -> setpoint",
        "setpoint: 23 -> 24.5",
        "ramp_action: setpoint -> off",
        "setpoint: 24.5 -> 23",
        "ramp_action: off -> off",  # the safe state writes each of its commands, whatever reads back
        "mode: auto -> off",
    ]
    assert [event["ok"] for event in short_run.events() if event["kind"] == "safe_state"] == [True] * 3


def test_virtual_and_blocks_carry_the_same_run_bit_for_bit(short_run, tmp_path):
    settings = acquisition.station(interface="virtual")
    run = run_job(acquisition.job(tmp_path, settings=settings)).run
    assert pq.read_table(run.data).equals(pq.read_table(short_run.data))
    assert run.manifest().losses == short_run.manifest().losses


def test_the_same_seed_makes_the_same_run_and_another_seed_another(short_run, tmp_path):
    again = run_job(acquisition.job(tmp_path)).run
    assert sha256(again.data) == sha256(short_run.data)
    other = run_job(acquisition.job(tmp_path, settings=acquisition.station(seed=2))).run
    first, second = (read_samples(run.data)["rate"][:1000] for run in (again, other))
    assert not np.array_equal(first, second)


def test_ends_safe_at_the_end_of_the_profile(world, tmp_path):
    assert run_job(acquisition.job(tmp_path)).error is None
    assert is_safe(world)


def test_a_bug_ends_safe_with_the_folder_finished_and_is_raised_again(world, tmp_path):
    with pytest.raises(ZeroDivisionError):
        run_job(acquisition.job(tmp_path), at(20, lambda station: 1 / 0))
    assert is_safe(world)
    (run,) = (open_run(path) for path in tmp_path.glob("*/*"))
    assert run.manifest().state == "failed"
    assert run.manifest().cause == "internal error: ZeroDivisionError: division by zero"
    assert run.manifest().segments[-1].outcome == "interrupted"


def test_an_interrupt_that_nobody_handled_ends_safe_too(world, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_job(acquisition.job(tmp_path), at(20, raising(KeyboardInterrupt())))
    assert is_safe(world)


def test_a_reading_that_cannot_be_true_ends_safe_as_a_failure_of_the_equipment(world, tmp_path):
    sensor_break = at(20, lambda station: world[0].chamber.set_words("temperature", (0x0000, 0x7FC0)))

    def look(station, status):  # the plant publishes every second, so the break must be put in after it
        if status.t_s >= 20:
            world[0].plant.state = replace(world[0].plant.state, process_value=float("nan"))
            world[0].plant.step = lambda *args, **kwargs: world[0].plant.state
            sensor_break(station, status)

    result = run_job(acquisition.job(tmp_path), look)
    assert isinstance(result.error, EquipmentError)
    assert "temperature" in str(result.error)
    assert is_safe(world)
    assert result.run.manifest().state == "failed"


def test_a_closed_terminal_ends_safe_unless_it_is_to_be_ignored(world, tmp_path):
    before = signal.getsignal(signal.SIGHUP)
    hang_up = partial(os.kill, os.getpid(), signal.SIGHUP)
    try:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        result = run_job(acquisition.job(tmp_path), at(20, lambda station: hang_up()))
        assert str(result.error) == "aborted by SIGHUP"
        assert is_safe(world)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
        assert run_job(acquisition.job(tmp_path), at(20, lambda station: hang_up())).error is None
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_lost_chamber_is_said_loudly_and_the_data_are_kept(world, tmp_path):
    result = run_job(acquisition.job(tmp_path, acquisition.LONG), at(20, lambda station: world[0].chamber.close()))
    assert isinstance(result.error, EquipmentError)
    assert result.error.exit_code == 4
    assert str(result.error).startswith("SAFE STATE NOT VERIFIED: set point to 23 degC")
    assert "switch the chamber off by hand" in str(result.error)
    assert "chamber link lost for 60 s" in str(result.error)
    manifest = result.run.manifest()
    assert manifest.state == "failed"
    assert manifest.rows >= 30 * 500
    steps = [event for event in result.run.events() if event["kind"] == "safe_state"]
    assert [event["ok"] for event in steps if "ok" in event] == [False] * 3


def test_a_silent_unit_trips_its_guard_and_ends_safe(world, tmp_path, capsys):
    result = run_job(acquisition.job(tmp_path), at(20, lambda station: world[0].units.clear()))
    assert isinstance(result.error, RunAborted)
    assert "unit silent: age of the newest frame" in str(result.error)
    assert capsys.readouterr().err == f"bench: {result.error}; the safe state was reached and read back\n"
    assert is_safe(world)
    assert result.run.manifest().state == "aborted"


def test_another_unit_in_mid_run_ends_safe(world, tmp_path):
    def swap(station):
        world[0].units[0].wire.serial = 77
        world[0].units[0].wire.reboot()

    result = run_job(acquisition.job(tmp_path), at(20, swap))
    assert isinstance(result.error, EquipmentError)
    assert "77 answers as number 0" in str(result.error)
    assert is_safe(world)


def test_a_unit_that_is_not_there_is_named_before_anything_moves(world, tmp_path):
    content = acquisition.station_content()
    content["units"] = [{**content["units"][0], "simulation": None}]
    settings = acquisition.station()

    class Silent(SimulatedStation):
        def advance(self, t0_s, t1_s):
            self.units.clear()
            super().advance(t0_s, t1_s)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.acquisition.station.simulation, "SimulatedStation", Silent)
        result = run_job(acquisition.job(tmp_path, settings=settings))
    assert isinstance(result.error, EquipmentError)
    assert str(result.error).startswith("not started: unit SIM-0001: no sound rate frame as number 0 on bus can0")
    assert "write" not in kinds(result.run)
    assert "safe_state" not in kinds(result.run)
    assert result.run.manifest().rows == 0


def test_the_wrong_unit_is_refused_before_anything_moves(world, tmp_path):
    units = [{"serial": "SIM-0001", "bus": "can0", "identity": 5}]

    def other(*args):
        simulated = simulate(*args)
        simulated.units[0].wire.serial = 6
        return simulated

    simulate = bench.acquisition.station.stage.simulate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.acquisition.station.stage, "simulate", other)
        result = run_job(acquisition.job(tmp_path, settings=acquisition.station(units=units)))
    assert isinstance(result.error, InputError)
    assert "6 answers as number 0, the station file says identity 5" in str(result.error)
    assert "write" not in kinds(result.run)


def test_a_guard_that_trips_before_the_start_leaves_the_chamber_as_it_was_found(world, tmp_path):
    guard = GuardSettings(name="too warm", signal="chamber_temperature", above=-10.0, delay_s=60.0)
    settings = acquisition.station().model_copy(update={"guards": (guard,)})
    result = run_job(acquisition.job(tmp_path, settings=settings))
    assert isinstance(result.error, RunAborted)
    assert result.error.exit_code == 3
    assert str(result.error).startswith("not started: too warm: chamber air temperature = ")
    assert "write" not in kinds(result.run)
    assert result.run.manifest().state == "aborted"


def test_a_full_disk_ends_safe_and_what_was_captured_stays_readable(world, tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        look = at(20, lambda station: resource.setrlimit(resource.RLIMIT_FSIZE, (450_000, limits[1])))
        result = run_job(acquisition.job(tmp_path, acquisition.LONG), look)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert isinstance(result.error, EquipmentError)
    assert result.error.exit_code == 4
    assert "cannot record" in str(result.error)
    assert is_safe(world)
    manifest = assemble(result.run)
    assert manifest.rows >= 450_000 // 24 * 500 // 603 - 1000  # all but the block that did not fit
    assert manifest.losses["lost"] == 0
    assert manifest.losses["journal_damaged_bytes"] > 0


def test_tables_that_do_not_fit_the_disk_can_be_made_later(world, tmp_path, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(bench.acquisition.run.runner, "assemble", full)
    result = run_job(acquisition.job(tmp_path))
    assert isinstance(result.error, EquipmentError)
    assert "No space left on device" in str(result.error)
    assert f"bench report {result.run.path}" in str(result.error)
    assert is_safe(world)
    assert assemble(result.run).state == "done"  # the journal knows that the run itself went well


def test_a_folder_that_cannot_be_made_is_bad_input(tmp_path):
    (tmp_path / "reports").write_text("a file")
    with pytest.raises(InputError, match="choose another place with --out"):
        run_job(acquisition.job(tmp_path / "reports"))


def test_memory_stays_flat(tmp_path):
    held = {}

    def look(station, status):
        if status.t_s == 40:
            tracemalloc.start(1)
        if status.t_s in (140, 240):
            held[status.t_s] = tracemalloc.get_traced_memory()[0]
        if status.t_s == 240:
            tracemalloc.stop()
            raise RunAborted("enough")

    run_job(acquisition.job(tmp_path, acquisition.LONG), look)
    assert held[240] - held[140] < 70_000  # 100 s of frames are 1.4 MB


SCRIPT = """
import sys
from pathlib import Path
from tests.support import acquisition
from bench.acquisition.run.runner import run_job
from bench.acquisition.run.wiring import Continue, Stop
run_job(acquisition.job(Path(sys.argv[1]), acquisition.LONG), lambda _, status: print(status.t_s, flush=True))
"""


@pytest.fixture
def start():
    """Start Python code in a process of its own; ended with the test."""
    paths = [str(Path(__file__).parents[2])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    started = []

    def run(code, *args):
        command = [sys.executable, "-c", code, *map(str, args)]
        pipe = subprocess.PIPE
        started.append(subprocess.Popen(command, env=environment, stdout=pipe, stderr=pipe, text=True))
        return started[-1]

    yield run
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("ticks", [1, 57])
def test_kill_9_loses_nothing_but_the_tick_it_fell_into(start, tmp_path, ticks):
    process = start(SCRIPT, tmp_path)
    lines = [process.stdout.readline() for _ in range(ticks)]
    process.kill()
    lines += process.stdout.read().splitlines()
    process.communicate()
    last_s = float(max(lines, key=lambda line: float(line or 0)))
    (folder,) = tmp_path.glob("*/*")
    assert not (folder / "manifest.json").exists()
    run = RunFolder(folder)
    manifest = assemble(run)
    assert (manifest.state, manifest.segments[-1].outcome) == ("aborted", "interrupted")
    assert "killed; recovered from its journals" in manifest.cause
    assert manifest.losses["lost"] == 0
    data = read_samples(run.data)
    time = data["time"][np.isfinite(data["rate"])]
    assert time[-1] >= last_s - 0.003
    assert np.allclose(np.diff(time), 0.002)


@pytest.mark.slow
def test_sigterm_ends_the_command_safe_with_exit_code_3(start, tmp_path):
    profile = tmp_path / "long.yaml"
    profile.write_text(acquisition.LONG)
    command = "from bench.cli import main; main()"
    process = start(command, "run", profile, "--out", tmp_path / "out", "--model", "polynomial")
    first = process.stderr.readline()
    assert "1/2 ramp to 85" in first
    process.send_signal(signal.SIGTERM)
    said = "".join(process.communicate())
    assert process.returncode == 3, said
    assert "aborted by SIGTERM" in said
    (folder,) = (tmp_path / "out").glob("*/*")
    run = open_run(folder)
    assert run.manifest().state == "aborted"
    assert [event["ok"] for event in run.events() if event["kind"] == "safe_state"] == [True] * 3
