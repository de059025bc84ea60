"""A real `bench run` in a process of its own, steered from here: status, hold, pause, resume, abort."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bench.acquisition.run import remote
from bench.record.folder import open_run
from tests.support.commands import bench
from tests.support.waiting import PATIENCE_S, until

PROFILE = """\
name: long
segments:
  - {kind: soak, name: first, duration_min: 3}
  - {kind: ramp, name: up, to_degc: 80, rate_degc_per_min: 0.05}
  - {kind: soak, name: last, duration_min: 6000}
"""


def asked(*arguments):
    answer = bench(*arguments, "--json")
    assert answer.exit_code == 0, answer.output + answer.stderr
    return json.loads(answer.stdout)


@pytest.fixture
def live(tmp_path):
    """A run of the embedded simulator, live: its process and its reports folder."""
    profile, out = tmp_path / "long.yaml", tmp_path / "reports"
    profile.write_text(PROFILE)
    process = start("run", profile, "--out", out, "--model", "polynomial", "--quiet")
    try:
        until(lambda: process.poll() is not None or [r for r in remote.live_below(out) if r.condition() == "live"])
        until(lambda: process.poll() is not None or "segment" in asked("status", "--out", out)["runs"][0])
        yield process, out
    finally:
        process.kill()
        process.communicate()


def events(run, kind):
    return [event for event in open_run(Path(run)).events() if event["kind"] == kind]


@pytest.mark.slow
def test_a_live_run_is_held_released_paused_and_aborted_safe_from_another_process(live):
    process, out = live
    (running,) = asked("status", "--out", out)["runs"]
    assert (running["pid"], running["state"]) == (process.pid, "running")
    assert running["units"][0]["losses"]["lost"] == 0
    held = asked("hold", "--out", out)
    assert held["state"] == "holding"
    assert remote.whoami() in held["holding"][0]
    assert asked("resume", "--out", out)["state"] == "running"
    assert asked("pause", running["run"])["state"] in {"pausing", "holding"}
    until(lambda: asked("status", running["run"])["runs"][0]["state"] == "holding")
    assert asked("resume", running["run"])["state"] == "running"
    text = bench("abort", running["run"])
    assert text.exit_code == 0
    assert f"aborted by {remote.whoami()}" in text.stdout
    assert "chamber off" in text.stdout
    said = "".join(process.communicate())
    assert process.returncode == 3, said
    requests = events(running["run"], "request")
    assert [event["request"] for event in requests] == ["hold", "resume", "pause", "resume", "stop"]
    assert all(remote.whoami() in event["who"] and event["utc"] for event in requests)
    assert all(event["ok"] for event in events(running["run"], "safe_state"))
    assert not (Path(running["run"]) / remote.LIVE).exists()


@pytest.mark.slow
def test_a_killed_run_is_seen_as_gone_and_says_how_to_go_on(live):
    process, out = live
    process.send_signal(signal.SIGKILL)
    process.wait()
    (gone,) = json.loads(bench("status", "--out", out, "--json").stdout)["runs"]
    assert gone["state"] == "gone"
    answer = bench("abort", gone["run"])
    assert answer.exit_code == 2
    assert f"`bench resume {gone['run']}` goes on with it" in answer.stderr
    assert bench("hold", "--out", out).stderr == f"bench: {out}: no live run here; --out names another place\n"


@pytest.mark.skipif(sys.platform == "win32", reason="stops a process by a signal")
@pytest.mark.slow
def test_a_stopped_process_is_silent_and_its_run_is_not_resumed(live, monkeypatch):
    process, out = live
    (run,) = remote.live_below(out)
    monkeypatch.setattr(remote.ask_run, "__defaults__", (0.5,))
    process.send_signal(signal.SIGSTOP)
    try:
        answer = bench("status", "--out", out, "--json")
        assert answer.exit_code == 4
        assert json.loads(answer.stdout)["runs"][0]["state"] == "silent"
        refused = bench("resume", run.path)
        assert refused.exit_code == 4
        assert "does not answer" in refused.stderr
    finally:
        process.send_signal(signal.SIGCONT)


def test_a_folder_that_is_no_run_is_refused_in_one_line(tmp_path):
    for command in ("status", "hold", "pause", "abort", "resume"):
        answer = bench(command, tmp_path / "nothing")
        assert answer.exit_code == 2
        assert len(answer.stderr.splitlines()) == 1
    assert bench("status", "--out", tmp_path).stdout == f"no live run below {tmp_path}\n"


BRIEF = """\
name: brief
settle: {band_degc: 1, unit_band_degc: 5, slope_degc_per_min: 20, dwell_min: 0.05, timeout_min: 5}
segments:
  - {kind: soak, name: warm, duration_min: 0.25}
"""


@pytest.mark.slow(first=True)
def test_a_bench_that_is_killed_in_real_time_goes_on_with_the_unit_that_kept_counting(tmp_path):
    """Servers, bench, watchdog and capture are processes of their own; only the bench is killed."""
    profile, station, out = tmp_path / "brief.yaml", tmp_path / "station.yaml", tmp_path / "reports"
    profile.write_text(BRIEF)
    served = start("sim", "--write-station", station)
    first = None
    try:
        until(station.exists)
        first = start("run", profile, "--station", station, "--out", out, "--quiet", "--model", "polynomial")
        (run,) = until(lambda: [r for r in remote.live_below(out) if r.condition() == "live"])
        until(lambda: asked("status", run.path)["runs"][0].get("t_s", 0.0) > 4.0)
        first.send_signal(signal.SIGKILL)
        first.wait()
        watchdog = run.path / "watchdog.jsonl"
        until(lambda: watchdog.exists() and '"took_s"' in watchdog.read_text())
        second = start("resume", run.path, "--quiet", "--json")
        said, complaints = second.communicate(timeout=PATIENCE_S)
        assert second.returncode in {0, 1}, complaints
        manifest = open_run(run.path).manifest()
        assert manifest.state == "done"
        assert [segment.name for segment in manifest.segments] == ["warm", "back to 23 (resumed)", "warm (resumed)"]
        gap = manifest.parts[1].gap
        assert gap.unit_power == "kept"
        assert (gap.before["on"], gap.after["on"]) == (True, False)  # the watchdog has switched it off
        assert gap.duration_known
        assert manifest.losses["lost"] == 0
        assert json.loads(said)["admissible"]
    finally:
        for process in (served, first):
            if process is not None:
                process.kill()
                process.communicate()


def start(*arguments):
    """The command line in a process of its own."""
    command = [sys.executable, "-c", "from bench.cli import main; main()", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
