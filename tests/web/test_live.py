"""Live runs in the server: found, asked seldom, and ended aloud."""

import json
import math
import os

import pytest

from bench.acquisition.run import control, remote
from bench.acquisition.run.control import Desk
from bench.base import hold
from bench.record import StartRecord
from bench.web.ground.settings import Settings
from bench.web.live import watching
from bench.web.live.finding import Finder, folder_of
from bench.web.live.starts import Starts
from bench.web.live.watching import PERIOD_S, SILENT_S
from tests.acquisition.test_control import STATION, status
from tests.support.live_desk import live
from tests.support.web_client import served


def test_a_live_run_is_seen_with_its_profile_its_guards_and_its_trace(desk, folder, watcher, heard):
    with live(desk, folder):
        watcher.turn(0.0)
        (seen,) = heard.runs
        told = seen.told()
    assert (told["run"], told["unit"], told["profile"], told["condition"]) == ("G-1/run", "G-1", "p", "live")
    assert (told["state"], told["t_s"], told["late_s"], told["guards"]) == ("running", 100.0, 0.0, [])
    assert told["curve"] == [(0.0, 23.0), (300.0, 33.0)]
    assert seen.mirror.since()["points"][0][:3] == [100.0, 25.1, 25.04]
    json.dumps(told, allow_nan=False)


def test_a_run_that_was_live_before_the_server_is_known_from_its_first_answer(desk, folder, watcher):
    with live(desk, folder):
        watcher.start()
        known = [(told["run"], told["state"]) for told in (watched.told() for watched in watcher.runs)]
        watcher.close()
    assert known == [("G-1/run", "running")]


def test_a_run_is_asked_five_times_a_second_at_most(desk, folder, watcher, monkeypatch):
    asked = []
    ask = remote.ask_run
    monkeypatch.setattr(watching, "ask_run", lambda *a, **k: asked.append(a[1]) or ask(*a, **k))
    with live(desk, folder):
        for turn in range(100):
            watcher.turn(turn * 0.01)
    assert 1 <= len(asked) <= 1 / PERIOD_S
    assert set(asked) == {"trace"}


def test_a_run_of_an_older_bench_is_live_without_curves(desk, folder, watcher, heard, monkeypatch):
    asked, ask = [], remote.ask_run

    def older(run, action, *more, **known):
        asked.append(action)
        return ask(run, "curves" if action == "trace" else action, *more, **known)

    monkeypatch.setattr(watching, "ask_run", older)
    with live(desk, folder):
        watcher.turn(0.0)
        desk.look(STATION, status(101.0))
        watcher.turn(1.0)
        (seen,) = heard.runs
        assert (seen.told()["condition"], seen.told()["t_s"], seen.mirror.since()["points"]) == ("live", 101.0, [])
    assert asked == ["trace", "status", "status"]  # it is asked for a trace once
    watcher.turn(2.0)
    assert heard.runs == []


def test_an_end_is_told_at_once_and_again_with_the_verdict(desk, folder, recorder, watcher, heard):
    with live(desk, folder):
        watcher.turn(0.0)
        recorder.event("request", "stop by Olena", request="stop", who="Olena")
        recorder.event("safe_state", "chamber off: read back", ok=True)
        recorder.event("end", "aborted by Olena", state="aborted")
        recorder.sync()
    watcher.turn(10.0)
    (end,) = heard.ends
    assert (end["run"], end["state"], end["cause"]) == ("G-1/run", "aborted", "aborted by Olena")
    assert (end["safe"], end["verdict"], end["analysing"]) == (True, None, True)
    assert end["requests"][0]["who"] == "Olena"
    assert heard.runs == []
    verdict = {"verdict": {"verdict": "partial", "sentence": "Aborted by Olena."}}
    (folder / "calibration.json").write_text(json.dumps(verdict))
    watcher.turn(20.0)
    assert len(heard.ends) == 1  # the report is not written yet
    (folder / "report.html").write_text("")
    watcher.turn(30.0)
    last = heard.ends[-1]
    assert (len(heard.ends), last["verdict"], last["sentence"], last["analysing"]) == (
        2, "partial", "Aborted by Olena.", False,
    )  # fmt: skip


def test_each_unit_is_told_as_soon_as_its_report_is_there(desk, folder, recorder, watcher, heard):
    other = folder.parents[1] / "G-2" / "run"
    other.mkdir(parents=True)
    with control.serve_desk(desk, [folder, other], [folder / "journal" / "bench.gtbj"]):
        watcher.turn(0.0)
        recorder.event("end", "profile done", state="done")
        recorder.sync()
    watcher.turn(10.0)
    (other / "calibration.json").write_text(json.dumps({"verdict": {"verdict": "adequate", "sentence": "Good."}}))
    (other / "report.html").write_text("")
    watcher.turn(20.0)
    for end in (heard.ends[-1], watcher.ended("G-1/run")):
        assert {unit["unit"]: unit["verdict"] for unit in end["units"]} == {"G-1": None, "G-2": "adequate"}
        assert end["analysing"]


def test_an_analysis_that_dies_is_told_with_why(desk, folder, recorder, watcher, heard, monkeypatch):
    said = {
        "unit": "G-1",
        "run": "G-1/run",
        "analysed": False,
        "verdict": "unproven",
        "sentence": "not analysed: no disk",
    }
    start = {"state": "ended", "exit_code": 4, "verdicts": [said], "message": "", "start": "s", "who": {}}
    monkeypatch.setattr(watcher._starts, "of_run", lambda run: start)
    with live(desk, folder):
        watcher.turn(0.0)
        recorder.event("end", "profile done", state="done")
        recorder.sync()
    watcher.turn(10.0)
    watcher.turn(20.0)
    assert len(heard.ends) == 1  # its process is this one, and lives
    monkeypatch.setattr(watching, "process_alive", lambda pid: False)
    watcher.turn(30.0)
    last = heard.ends[-1]
    assert (last["state"], last["analysing"], last["units"][0]["analysed"]) == ("done", False, False)
    assert last["units"][0]["sentence"] == "not analysed: no disk"
    assert watcher.ended("G-1/run") is None


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (None, "the reason is not known"),
        (
            {"state": "ended", "exit_code": None, "message": "killed; `bench report` …"},
            "something ended its process",
        ),
        ({"state": "ended", "exit_code": 4, "message": "no memory"}, "no memory"),
    ],
)
def test_a_run_without_report_is_not_analysed_whatever_server_tells_it(folder, out, start, words, monkeypatch):
    (folder / "manifest.json").write_text(json.dumps({"state": "done", "cause": "profile done"}))
    about = {
        "start": "s",
        "who": {"name": "Olena"},
        "verdicts": [],
        "plan": "p",
        "station": "s",
        "units": [],
        "digest": "",
    }
    with served(Settings(out=out)) as client:
        monkeypatch.setattr(Starts, "of_run", lambda self, run: {**about, **start} if start else None)
        end = client.get("/api/v1/live/G-1/run").json()["ended"]
        assert (end["state"], end["analysing"], end["units"][0]["analysed"]) == ("done", False, False)
        assert end["units"][0]["sentence"] == f"not analysed: {words}"
        monkeypatch.setattr(Starts, "of_run", lambda self, run: {**about, "state": "running", "exit_code": None})
        assert client.get("/api/v1/live/G-1/run").json()["ended"]["analysing"]
        (folder / "report.html").write_text("")
        end = client.get("/api/v1/live/G-1/run").json()["ended"]
        assert (end["analysing"], end["units"][0]["analysed"], end["units"][0]["sentence"]) == (False, True, "")


def test_an_end_with_a_way_that_is_not_read_back_yet_is_told(desk, folder, recorder, watcher, heard):
    with live(desk, folder):
        watcher.turn(0.0)
        recorder.event("safe_state", "warming up first: it is cold inside")  # no `ok`: a word on the way
        recorder.event("safe_state", "chamber off: read back", ok=True)
        recorder.event("end", "aborted", state="aborted")
        recorder.sync()
    watcher.turn(10.0)
    (end,) = heard.ends
    assert (end["safe"], end["safe_state"][-1]) == (True, {"text": "chamber off: read back", "ok": True})


def test_an_end_that_cannot_be_understood_is_told_and_the_others_are_watched_on(
    desk, folder, out, watcher, heard, monkeypatch
):
    other = out / "G-2" / "run"
    other.mkdir(parents=True)
    second = Desk()
    with control.serve_desk(second, [other]):
        with live(desk, folder):
            watcher.turn(0.0)
            monkeypatch.setattr(watching.story, "ending", lambda run: 1 / 0)
        watcher.turn(10.0)
        (end,) = heard.ends
        assert (end["run"], end["safe"], end["cause"]) == (
            "G-1/run",
            None,
            "how it ended cannot be read: look at the chamber",
        )
        assert [watched.runs for watched in heard.runs] == [["G-2/run"]]


def test_a_killed_run_stays_in_view_and_says_how_to_go_on(desk, folder, watcher, heard):
    with live(desk, folder):
        watcher.turn(0.0)
        text = (folder / remote.LIVE).read_text()
    (folder / remote.LIVE).write_text(text)
    for turn in range(1, 4):
        watcher.turn(turn * 2 * SILENT_S)
    told = heard.runs[0].told()
    assert (told["condition"], told["state"], heard.ends) == ("gone", "gone", [])
    assert "`bench resume G-1/run` goes on with it" in told["detail"]


def test_a_killed_run_that_is_about_to_go_on_has_not_ended_and_is_then_one_run(desk, folder, watcher, heard, tmp_path):
    other, runs = folder.parents[1] / "G-2" / "run", ["G-1/run", "G-2/run"]
    other.mkdir(parents=True)
    with live(desk, folder):
        text = (folder / remote.LIVE).read_text()
        (other / remote.LIVE).write_text(text)
        watcher.turn(0.0)
    (folder / remote.LIVE).write_text(text)
    watcher.turn(2 * SILENT_S)
    start = tmp_path / "own" / "starts" / "20261128T100000000000Z-1"
    start.mkdir(parents=True)
    StartRecord(start=start.name, started="2026-11-28T10:00:00+00:00", resumes="G-1/run").write(start)
    with (start / "lock").open("wb") as lock:
        hold(lock)  # its process lives
        (folder / remote.LIVE).unlink()
        watcher.turn(4 * SILENT_S)
        assert ([(watched.condition, watched.runs) for watched in heard.runs], heard.ends) == ([("gone", runs)], [])
        with live(desk, folder):
            (other / remote.LIVE).write_text((folder / remote.LIVE).read_text())
            watcher.turn(6 * SILENT_S)
            assert ([(watched.condition, watched.runs) for watched in heard.runs], heard.ends) == ([("live", runs)], [])


def test_a_run_that_does_not_answer_is_silent_and_left_alone_for_a_while(folder, watcher, heard, monkeypatch):
    asked = []

    def silent(run, *_, **__):
        asked.append(run)
        raise remote.EquipmentError("does not answer; look at the chamber") from TimeoutError()

    monkeypatch.setattr(watching, "ask_run", silent)
    remote.LiveFile(os.getpid(), 9, "2026", [], "t").write(folder)
    for turn in range(20):
        watcher.turn(turn * PERIOD_S)
    assert heard.runs[0].told()["condition"] == "silent"
    assert len(asked) == math.ceil(20 * PERIOD_S / SILENT_S)


def test_a_unit_that_left_does_not_tell_how_the_run_ended(out, tmp_path):
    left = {"kind": "end", "text": "no frames", "state": "failed", "sound_until_s": 5.0}
    over = [
        {"kind": "safe_state", "text": "chamber off", "ok": False},
        {"kind": "end", "text": "over", "state": "done"},
    ]
    outside = tmp_path / "elsewhere" / "run"
    for folder, other, events, state in (
        (out / "G-1" / "r", "../../G-2/r", [left], "failed"),
        (out / "G-2" / "r", "../../G-1/r", over, "done"),
        (outside, "", over, "done"),
    ):
        folder.mkdir(parents=True, exist_ok=True)
        companions = [{"unit": "G", "run": run} for run in (other, "../../../elsewhere/run", str(outside), "nonsense")]
        manifest = {"format": 1, "state": state, "cause": events[-1]["text"], "companions": companions}
        (folder / "manifest.json").write_text(json.dumps(manifest))
        (folder / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    with served(Settings(out=out)) as client:
        for unit in ("G-1", "G-2"):
            end = client.get(f"/api/v1/live/{unit}/r").json()["ended"]
            assert sorted(end["runs"]) == ["G-1/r", "G-2/r"], "and none from outside of the store"
            assert (end["state"], end["cause"], end["safe"]) == ("done", "over", False)


def test_a_run_whose_loop_hangs_is_not_shown_as_running(desk, folder, watcher, heard, monkeypatch):
    with live(desk, folder):
        desk._seen_wall_s -= 60.0
        watcher.turn(0.0)
        hung = heard.runs[0].told()
        desk.look(STATION, status(101.0))
        watcher.turn(2 * SILENT_S)
        again = heard.runs[0].told()
        desk.ends("aborted by guard: chamber silent")
        desk._seen_wall_s -= 60.0  # the way to the safe state has no ticks
        watcher.turn(4 * SILENT_S)
        ends = heard.runs[0].told()
    assert (hung["condition"], hung["state"]) == ("silent", "silent")
    assert "its loop has not ticked for 60 s" in hung["detail"]
    assert (again["condition"], again["state"]) == ("live", "running")
    assert (ends["condition"], ends["state"], ends["ending"]) == ("live", "ending", "aborted by guard: chamber silent")


def test_one_run_that_cannot_be_understood_hides_no_other(desk, folder, watcher, heard, monkeypatch):
    other = folder.parent / "other"
    other.mkdir()
    remote.LiveFile(1, 9, "2025", [], "t").write(other)
    told, ask = watching.describe, watching.ask_run

    def describe(run, start):
        return {}["nonsense"] if run.path == other else told(run, start)

    monkeypatch.setattr(watching, "describe", describe)
    with live(desk, folder):
        watcher.turn(0.0)
        assert [run.about["run"] for run in heard.runs] == ["G-1/run"]
        monkeypatch.setattr(watching, "describe", told)
        monkeypatch.setattr(watching, "ask_run", lambda run, *a, **k: {} if run.path == other else ask(run, *a, **k))
        watcher.turn(10.0)
    by_run = {run.about["run"]: run.told() for run in heard.runs}
    assert by_run["G-1/run"]["condition"] == "live"
    assert by_run["G-1/other"]["condition"] == "silent"
    assert "look at the chamber" in by_run["G-1/other"]["detail"]


def test_a_folder_that_cannot_be_looked_into_hides_no_run(desk, folder, tmp_path, monkeypatch):
    def refused(path):
        raise PermissionError(13, "Permission denied")

    (folder.parent / "locked").mkdir()
    elsewhere = tmp_path / "elsewhere" / "run"
    elsewhere.mkdir(parents=True)
    remote.LiveFile(1, 9, "2025", [], "t").write(elsewhere)
    (tmp_path / "reports" / "linked").symlink_to(elsewhere.parent)
    monkeypatch.setattr("pathlib.Path.exists", refused)
    with live(desk, folder):
        found = Finder(tmp_path / "reports").look()
    assert [run.path for run in found] == [folder]
    assert folder_of(tmp_path / "reports", "linked", "run") is None


def test_a_new_run_is_found_at_once_and_an_old_folder_that_goes_live_again_soon(tmp_path):
    now = [0.0]
    old = tmp_path / "G-2" / "old"
    old.mkdir(parents=True)
    os.utime(old.parent, (1e9, 1e9))
    finder = Finder(tmp_path, lambda: now[0])
    assert finder.look() == []
    new = tmp_path / "G-1" / "new"
    new.mkdir(parents=True)
    for path in (new, old):
        remote.LiveFile(1, 9, path.name, [], path.name).write(path)
    assert [run.path for run in finder.look()] == [new]
    now[0] = 60.0
    assert [run.path for run in finder.look()] == [new, old]
    (new / remote.LIVE).unlink()
    assert [run.path for run in finder.look()] == [old]


def test_a_folder_is_looked_up_and_never_joined(tmp_path):
    (tmp_path / "out" / "G-1" / "run").mkdir(parents=True)
    (tmp_path / "secret" / "run").mkdir(parents=True)
    root = tmp_path / "out"
    assert folder_of(root, "G-1", "run") == root / "G-1" / "run"
    for unit, run in (("..", "secret"), ("../secret", "run"), ("G-1", ".."), ("G-1", "../../secret"), ("", ""),
                      (str(tmp_path / "secret"), "run"), ("G-1/run", ".")):  # fmt: skip
        assert folder_of(root, unit, run) is None
