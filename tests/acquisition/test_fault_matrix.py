"""Every line of the fault matrix: how the run ends, what is said, where the chamber stands, what became of the data."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import shutil
import signal
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import bench.acquisition.run.runner
import bench.acquisition.station.rate_table
import bench.acquisition.station.stage
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.run.continuation import plan
from bench.acquisition.run.runner import Job, run_job
from bench.acquisition.station.settings.faults import PANEL
from bench.base import config
from bench.base.errors import BenchError
from bench.record.folder import RunFolder
from bench.record.samples import read_samples
from benchmarks.spoiled_unit_data import Case as Spoiling
from benchmarks.spoiled_unit_data import Wire
from drivers.errors import DriverError
from drivers.journal import Damage, Kind, read_blocks
from drivers.sim.cia402_table import SimulatedTable
from drivers.wire import load_dbc
from tests.acquisition.test_runner import SCRIPT, start  # noqa: F401
from tests.acquisition.test_spoiled_unit_data import Twin
from tests.acquisition.test_turning import RATES
from tests.acquisition.test_turning import job as table_job
from tests.acquisition.test_turning import station as table_station
from tests.acquisition.test_watchdog import PATIENCE_S, World
from tests.support import acquisition
from tests.support.fault_matrix import BUS, MATRIX, PAGE, Case, markdown

PROFILE = """\
name: matrix
segments:
  - {kind: ramp, to_degc: 24, rate_degc_per_min: 2, arrival_band_degc: 0.7}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 2, arrival_band_degc: 0.8}
  - {kind: soak, duration_min: 0.2}
"""
LONG = "name: matrix\nsegments:\n  - {kind: ramp, to_degc: 60, rate_degc_per_min: 2}\n"
FOUR = acquisition.STATION.parent / "four_units.yaml"
AT_S = 20.0
RATE_HZ = 500
SAFE = (23.0, False, None)
NAMES = {message.id: message.name for message in load_dbc("vibratory").values()}
SLOW = ("GYRO_RES", "GYRO_AMP", "GYRO_SUPPLY")


@dataclass
class Outcome:
    """How a run ended."""

    runs: list[RunFolder]
    exit_code: int
    said: str
    chamber: tuple | None = None
    """Set point, on, ramp of the simulated controller itself, afterwards."""
    struck: dict = field(default_factory=dict)
    """Frames struck, by fault and identifier."""
    counts: dict = field(default_factory=dict)
    """Answers and frames struck, by fault."""


class Lab:
    """Where cases are run; keeps the simulated station of the last run for an independent look at it."""

    def __init__(self, path, monkeypatch, start):  # noqa: F811
        self.path, self.patch, self.start = path, monkeypatch, start
        self.world = []
        original = bench.acquisition.station.stage.simulate
        monkeypatch.setattr(
            bench.acquisition.station.stage,
            "simulate",
            lambda *args: self.world.append(original(*args)) or self.world[-1],
        )

    def settings(self, case, base=acquisition.STATION):
        content = json.loads(json.dumps(config.read_yaml(base).content))
        content["faults"] = [{"at_s": AT_S, **fault} for fault in case.faults]
        for key, value in case.station.items():
            place = content
            *above, last = key.split(".")
            for name in above:
                place = place[name]
            place[last] = self.with_door() if value == "with_door" else value
        return config.load_config(config.parse_yaml(json.dumps(content), "station.yaml"), acquisition.StationSettings)

    def with_door(self):
        source = Path(bench.__file__).parent.parent / "drivers" / "chambers" / "watlow_f4t.yaml"
        door = "  door: {address: 12000, type: uint16, values: {closed: 62, open: 63}, meaning: door, source: CCL}\n"
        text = source.read_text().replace("power, mode_active]", "power, mode_active]", 1)
        text = text.replace("secondary: [", "secondary: [door, ", 1).replace("registers:\n", f"registers:\n{door}", 1)
        (self.path / "door.yaml").write_text(text)
        return str(self.path / "door.yaml")

    def run(self, job, look=lambda station, status: None):
        stations = []

        def onlooker(station, status):
            stations[:] = [station]
            look(station, status)

        try:
            result = run_job(job, onlooker)
        except (BenchError, DriverError) as error:
            return Outcome([], 2, str(error))
        error = result.error
        outcome = Outcome([unit.run for unit in result.units], error.exit_code if error else 0, str(error or ""))
        commands = self.world[-1].chamber.commands()
        outcome.chamber = (commands.setpoint, commands.on, commands.ramp_rate_degc_per_min)
        if stations and stations[0].injection is not None:
            injection = stations[0].injection
            for bus in injection.wires.values():
                outcome.struck |= bus.struck
            for wire in (*injection.wires.values(), *filter(None, [injection.proxy])):
                outcome.counts |= wire.counts
        return outcome

    def job(self, case, text=PROFILE):
        return acquisition.job(self.path / "out", text, self.settings(case))


@pytest.fixture
def lab(tmp_path, monkeypatch, start):  # noqa: F811
    return Lab(tmp_path, monkeypatch, start)


def once(action, at_s=AT_S):
    done = []

    def look(station, status):
        if status.t_s >= at_s and not done:
            done.append(True)
            action(station)

    return look


# ---- procedures: how a fault is made ---------------------------------------------------------------------------------


def rehearsal(lab, case):
    commanded_again = any(fault["fault"] == "limits" for fault in case.faults)
    return lab.run(lab.job(case, PROFILE if case.state == "done" or commanded_again else LONG))


def four(lab, case):
    settings = lab.settings(case, FOUR)
    return lab.run(acquisition.job(lab.path / "out", PROFILE, settings))


def fahrenheit(lab, case):
    look = lambda *args: lab.world[-1].chamber.set_value("temperature_unit", "fahrenheit") or lab.world[-1]  # noqa: E731
    original = bench.acquisition.station.stage.simulate
    lab.patch.setattr(bench.acquisition.station.stage, "simulate", lambda *args: original(*args) and look())
    return lab.run(lab.job(case))


def capture_killed(lab, case):
    """As a rehearsal would, with the words of a capture process that is gone."""

    class Gone:
        def __init__(self, capture):
            self.capture = capture

        def __getattr__(self, name):
            return getattr(self.capture, name)

        def health(self):
            from dataclasses import replace

            return replace(self.capture.health(), error="capture process ended (exit code -9)", ended=True)

    def kill(station):
        station._captures[BUS] = Gone(station._captures[BUS])

    return lab.run(lab.job(case, LONG), once(kill))


def signalled(number):
    def run(lab, case):
        before = signal.getsignal(number)
        try:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
            return lab.run(lab.job(case, LONG), once(lambda station: os.kill(os.getpid(), number)))
        finally:
            signal.signal(number, before)

    return run


def bug(lab, case):
    with pytest.raises(ZeroDivisionError) as raised:
        run_job(lab.job(case, LONG), once(lambda station: 1 // 0))
    commands = lab.world[-1].chamber.commands()
    runs = [RunFolder(path) for path in (lab.path / "out").glob("*/*")]
    return Outcome(runs, 1, repr(raised.value), (commands.setpoint, commands.on, commands.ramp_rate_degc_per_min))


def killed(lab, case):
    process = lab.start(SCRIPT, lab.path / "out")
    for _ in range(37):
        process.stdout.readline()
    process.kill()
    process.communicate()
    (run,) = (RunFolder(path) for path in (lab.path / "out").glob("*/*"))
    assemble(run)
    return Outcome([run], process.returncode, run.manifest().cause)


def real(number):
    def run(lab, case):
        world = World(lab.path)
        try:
            world.simulate(0.05)
            process, run = world.run()
            time.sleep(2.0)
            last_ns = max(b.frames()["t_ns"][-1] for b in blocks(run) if b.kind is Kind.FRAMES)
            process.send_signal(number)
            world.panel.wait_for(23.0, False)
            code = process.wait(PATIENCE_S)
            process.stderr.read()
            assemble(run)
            data = read_samples(run.data)["time"]
            assert data[-1] >= last_ns * 1e-9 - 1.0
            return Outcome([run], code, run.manifest().cause, SAFE)
        finally:
            world.close()

    return run


def tear(run, at):
    for journal in run.journal.iterdir():
        os.truncate(journal, at(journal.stat().st_size))


def spoiled(kind, length_s, text):
    def run(lab, case):
        before = bench.acquisition.station.stage.simulate

        def simulate(*args):
            world = before(*args)
            for unit in world.units:
                wire = Twin(unit.wire.bus, 0) if kind == "twin" else Wire(unit.wire.bus, Spoiling(kind, length_s), 1)
                unit.wire.bus = wire
            return world

        lab.patch.setattr(bench.acquisition.station.stage, "simulate", simulate)
        return lab.run(lab.job(case, text))

    return run


def removed(lab, case):
    outcome = lab.run(lab.job(case, LONG), once(lambda station: shutil.rmtree(lab.path / "out")))
    return Outcome([], outcome.exit_code, outcome.said, outcome.chamber)


def power_cut(lab, case):
    """The journals as they stood at some byte: torn at random; the last one is resumed."""
    rng = np.random.default_rng(5)

    def cut(station):
        shutil.copytree(lab.path / "out", lab.path / "cut")

    run_job(lab.job(case), once(cut, 60))
    (folder,) = (lab.path / "cut").glob("*/*")
    run = RunFolder(folder)
    for n in range(8):
        torn = RunFolder(shutil.copytree(folder, lab.path / f"torn{n}"))
        tear(torn, lambda size: int(rng.integers(2000, size)))
        manifest = assemble(torn)
        assert (manifest.state, manifest.losses["lost"]) == ("aborted", 0)
        check_data(case, torn, manifest.losses)
    tear(run, lambda size: size - int(rng.integers(1, 3000)))
    profile, station = profile_from_text(PROFILE), lab.settings(case)
    text = json.dumps(acquisition.station_content())
    continuation = plan(run, profile, station)
    return lab.run(Job(profile, PROFILE, station, text, {}, continuation.serials, continuation=continuation))


def disk_full(lab, case):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        full = once(lambda station: resource.setrlimit(resource.RLIMIT_FSIZE, (450_000, limits[1])))
        outcome = lab.run(lab.job(case, LONG), full)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assemble(outcome.runs[0])
    return outcome


def tables_full(lab, case):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.acquisition.run.runner, "assemble", full)
        outcome = lab.run(lab.job(case))
    (run,) = outcome.runs
    assert assemble(run).state == "done"
    return outcome


def disk_low(lab, case):
    usage = type("Usage", (), {"free": 5e7})
    low = once(lambda station: lab.patch.setattr(bench.acquisition.run.runner.shutil, "disk_usage", lambda path: usage))
    return lab.run(lab.job(case, LONG), low)


def clock_jump(lab, case):
    now_ns, now = time.time_ns, time.time
    ahead = 86_400

    def jump(station):
        lab.patch.setattr(time, "time_ns", lambda: now_ns() + ahead * 10**9)
        lab.patch.setattr(time, "time", lambda: now() + ahead)

    outcome = lab.run(lab.job(case), once(jump))
    walls = [block.wall_ns for block in blocks(outcome.runs[0])]
    assert max(walls) - min(walls) >= ahead * 10**9
    return outcome


def drive(action):
    def run(lab, case):
        class Failing(SimulatedTable):
            def advance(self, t0_s, t1_s):
                if self.rate_dps > 15:
                    action(self)
                return super().advance(t0_s, t1_s)

        lab.patch.setattr(bench.acquisition.station.rate_table, "SimulatedTable", Failing)
        lab.patch.setattr(
            "canopen.sdo.client.SdoClient.RESPONSE_TIMEOUT", 0.03
        )  # of wall time: bench time stands still
        return lab.run(table_job(lab.path / "out", RATES, table_station(**case.station)))

    return run


IN_REAL_TIME = {"killed_real", "hangs"}
HOW = {
    "rehearsal": rehearsal,
    "four": four,
    "fahrenheit": fahrenheit,
    "capture_killed": capture_killed,
    "sigint": signalled(signal.SIGINT),
    "sigterm": signalled(signal.SIGTERM),
    "sighup": signalled(signal.SIGHUP),
    "bug": bug,
    "killed": killed,
    "killed_real": real(signal.SIGKILL),
    "hangs": real(signal.SIGSTOP),
    "power_cut": power_cut,
    "removed": removed,
    "disk_full": disk_full,
    "tables_full": tables_full,
    "disk_low": disk_low,
    "clock_jump": clock_jump,
    "drive_fault": drive(lambda table: table.fail(0x8611)),
    "drive_cut": drive(lambda table: table.cut()),
}


# ---- what is asserted of each ----------------------------------------------------------------------------------------


def blocks(run):
    return [block for path in sorted(run.journal.glob("*.gtbj")) for block in read_blocks(path)]


def expected(want, fault, struck):
    """Number of losses that a case tells, from what was struck."""
    if not isinstance(want, str):
        return want
    by_name = {NAMES.get(identifier & 0x1FFFFFF0, NAMES.get(identifier)): n for (name, identifier), n in struck.items()
               if name == fault}  # fmt: skip
    kinds = {"rate": ("GYRO_RATE",), "slow": SLOW, "sampled": ("GYRO_RATE", *SLOW)}
    return sum(by_name.get(name, 0) for name in kinds[want])


def check_losses(case: Case, losses, struck):
    left = {
        name: count for name, count in losses.items() if count and name not in ("received", "journal_damaged_bytes")
    }
    for name, want in case.losses.items():
        found = left.pop(name, 0)
        if want == "some":
            assert found > 0, name
        elif isinstance(want, str) and want.startswith("about"):
            assert found == pytest.approx(int(want.split()[1]), abs=2), name
        else:
            assert found == expected(want, case.faults[0]["fault"], struck) > 0, name
    return left


def check_data(case: Case, run, losses):
    """No time stamp twice, and each sample is there or counted as lost."""
    times, rates = read_samples(run.data, "time", "rate").values()
    assert np.all(np.diff(times) > 0), "time stamps"
    heard = times[np.isfinite(rates)]
    if case.how == "rehearsal" and case.data.startswith(("whole", "frames whole")):
        stops = "silence" in case.data or "failure" in case.data
        ended_s = AT_S if stops else next(event["t_s"] for event in run.events() if event["kind"] == "end")
        assert heard[0] < 1.0
        assert heard[-1] == pytest.approx(ended_s, abs=2.0), "data end with the run"
    if len(heard) and case.how != "power_cut" and not case.data.startswith("left out from"):
        sent = round((heard[-1] - heard[0]) * RATE_HZ) + 1
        missing = losses["lost"] + losses["late"] + losses["invalid"]
        assert sent - len(heard) - missing <= 1 + losses["resets"], "samples are missing and not counted"
        if case.how not in IN_REAL_TIME:  # there a busy machine makes samples before the first that is heard late, too
            assert sent - len(heard) - missing >= -1 - losses["resets"], "samples are counted as lost and are there"


@pytest.mark.parametrize("case", MATRIX, ids=lambda case: f"{case.group}: {case.name}")
@pytest.mark.slow
def test_fault(lab, case):
    how = HOW.get(case.how) or spoiled(
        case.how.removeprefix("spoiled: "), *((6.0, PROFILE) if case.state == "done" else (1e9, LONG))
    )
    outcome = how(lab, case)
    assert outcome.exit_code == case.exit_code, outcome.said
    assert re.search(case.cause, outcome.said), outcome.said
    if case.safe is not False and outcome.chamber is not None and case.safe is not None:
        assert outcome.chamber == SAFE
    if case.safe is False:
        assert outcome.chamber != SAFE
        assert "NOT VERIFIED" in outcome.said
    if not outcome.runs:
        return
    if case.how == "rehearsal" and case.safe is not None and case.group != "Instruments":
        for fault in case.faults:
            assert fault["fault"] in (*PANEL, "other_unit") or outcome.counts[fault["fault"]] > 0, "it never struck"
    manifests = [run.manifest() for run in outcome.runs]
    if case.how == "four":
        gone = [m for m in manifests if m.state != "done"]
        assert {m.state for m in gone} == {case.state}
        assert len(gone) == (2 if "bus" in case.name else 1)
        assert all(re.search(case.cause.removeprefix("dropped: "), m.cause) for m in gone)
    else:
        assert manifests[0].state == (case.state if case.how != "tables_full" else "done")
        left = check_losses(case, manifests[0].losses, outcome.struck)
        if case.how in IN_REAL_TIME:  # a busy machine makes samples, or their temperatures, late, which are counted
            left = {name: count for name, count in left.items() if name not in {"late", "invalid"}}
        assert not left, "losses that nobody injected"
    kind, _, pattern = case.event.partition(": ")
    events = [event for event in outcome.runs[0].events() if event["kind"] == kind]
    texts = [json.dumps(event) for event in events]
    assert not kind or any(re.search(pattern, text) for text in texts), texts or f"no event {kind}"
    for run, manifest in zip(outcome.runs, manifests, strict=True):
        check_data(case, run, manifest.losses)
        damage = Damage()
        for path in run.journal.glob("*.gtbj"):
            list(read_blocks(path, damage))
        torn = case.how in ("disk_full", "power_cut")
        assert torn == (manifest.losses["journal_damaged_bytes"] > 0) or case.how.startswith(("killed", "hangs"))


def test_the_page_is_current():
    assert PAGE.read_text(encoding="utf-8") == markdown(), "run `python -m tests.support.fault_matrix`"


def test_the_names_of_the_cases_are_their_own():
    assert len({(case.group, case.name) for case in MATRIX}) == len(MATRIX)
