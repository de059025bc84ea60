"""Live runs in the server: found, asked seldom, mirrored, streamed to slow browsers and fast ones, and ended aloud."""

import asyncio
import json
import math
import os
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.recording.trace import Trace
from bench.acquisition.run import control, remote
from bench.acquisition.run.control import Desk
from bench.record import Begun, RunFolder
from bench.web.ground.settings import Settings
from bench.web.live import watching
from bench.web.live.finding import Finder, folder_of
from bench.web.live.mirror import Mirror
from bench.web.live.starts import Starts
from bench.web.live.streaming import KEPT, KEPT_ENDS, Stream
from bench.web.live.telling import Teller
from bench.web.live.watching import PERIOD_S, SILENT_S, Watcher
from bench.web.people import people
from drivers.clock import SimClock
from tests.acquisition.test_control import STATION, Sequencer, status
from tests.support.page_modules import told
from tests.support.web_client import served

PROFILE = "name: p\nsegments:\n  - {kind: ramp, to_degc: 33, rate_degc_per_min: 2}\n"


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "reports" / "G-1" / "run"
    (path / "journal").mkdir(parents=True)
    (path / "profile.yaml").write_text(PROFILE)
    return path


@pytest.fixture
def out(folder):
    return folder.parent.parent


@pytest.fixture
def recorder(folder):
    recorder = Recorder(RunFolder(folder), SimClock(), Begun(run="run"))
    yield recorder
    recorder.close()


@pytest.fixture
def desk():
    desk = Desk()
    desk.attach(Sequencer(), 300.0)
    desk.look(STATION, status(100.0))
    return desk


class Heard:
    """A listener that remembers."""

    def __init__(self):
        self.runs, self.ends = [], []

    def __call__(self, runs, ends):
        self.runs = runs
        self.ends += ends


@pytest.fixture
def heard():
    return Heard()


@pytest.fixture
def watcher(out, tmp_path, heard):
    return Watcher(out, Starts(tmp_path / "own", out, tmp_path), heard)


def live(desk, folder):
    return control.serve_desk(desk, [folder], [folder / "journal" / "bench.gtbj"])


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


def test_an_analysis_that_dies_is_told_with_why_and_what_to_do(desk, folder, recorder, watcher, heard, monkeypatch):
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
    assert last["units"][0]["sentence"] == f"not analysed: no disk; `bench report {folder}` analyses it"
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
        assert end["units"][0]["sentence"] == f"not analysed: {words}; `bench report {folder}` analyses it"
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
    assert f"`bench resume {folder}` goes on with it" in told["detail"]


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


@given(st.lists(st.integers(1, 40), min_size=1, max_size=12))
def test_a_mirror_shows_the_trace_itself_whatever_the_pace(bursts):
    trace, mirror, tick = Trace(capacity=64), Mirror(), 0
    for burst in bursts:
        for _ in range(burst):
            trace.add(float(tick), (1.0, 2.0), [("G-1", 3.0, (float(tick), float(tick), float(tick), 1))])
            tick += 1
        since, generation = mirror.wanted
        mirror.take(trace.since(since, generation))
        assert mirror.since() == trace.since()


def test_a_mirror_shows_a_new_generation_when_it_is_whole(monkeypatch):
    monkeypatch.setattr("bench.acquisition.recording.trace._PAGE_BYTES", 100 * 10)  # ten points a page
    trace, mirror = Trace(capacity=64), Mirror()

    def fetch():
        mirror.take(trace.since(*mirror.wanted))

    def add(ticks):
        for tick in range(ticks):
            trace.add(float(tick), (1.0, 2.0), [("G-1", 3.0, (0.0, 0.0, 0.0, 1))])

    add(63)
    for _ in range(7):
        fetch()
    assert (mirror.since()["count"], mirror.behind) == (63, False)
    add(1)
    fetch()
    assert (mirror.since()["count"], mirror.behind) == (63, True)
    for _ in range(3):
        fetch()
    assert (mirror.since()["count"], mirror.since()["every_s"], mirror.behind) == (32, 2.0, False)


def play(scene):
    """Run a scene in a thread: the browser of another test may have left a loop in this one."""
    with ThreadPoolExecutor(1) as thread:
        thread.submit(lambda: asyncio.run(scene())).result()


async def read(events, count):
    """The next so many events: id, name, data."""
    found = []
    async for event in events:
        lines = dict(line.split(": ", 1) for line in event.decode().strip().split("\n"))
        if "event" in lines:
            found.append((int(lines["id"]), lines["event"], json.loads(lines["data"])))
        if len(found) == count:
            break
    return found


def test_a_slow_browser_gets_the_newest_pictures_and_every_end_and_nothing_grows():
    async def scene():
        stream = Stream()
        slow = stream.listen()
        await anext(slow)
        for turn in range(1000):
            stream.live({"turn": turn})
            if turn % 100 == 0:
                stream.ended({"run": f"G-1/{turn}"})
        (browser,) = stream._browsers
        assert (len(browser.live), len(browser.ends)) == (KEPT, 10)
        got = await read(slow, KEPT + 10)
        assert [data["run"] for _, name, data in got if name == "ended"] == [f"G-1/{n}" for n in range(0, 1000, 100)]
        assert [data["turn"] for _, name, data in got if name == "live"] == [996, 997, 998, 999]
        assert [number for number, *_ in got] == sorted(number for number, *_ in got)
        await slow.aclose()
        assert stream.listeners == 0
        for turn in range(1000):
            stream.ended({"run": turn})
        assert len(stream._ends) == KEPT_ENDS

    play(scene)


def test_who_comes_back_gets_the_ends_that_were_missed_and_the_present():
    async def scene():
        stream = Stream()
        stream.live({"turn": 1})
        stream.ended({"run": "first"})
        stream.ended({"run": "second"})
        stream.live({"turn": 2})
        got = await read(stream.listen(since=2), 2)
        assert [(name, *data.values()) for _, name, data in got] == [("ended", "second"), ("live", 2)]
        ((_, name, data),) = await read(stream.listen(), 1)
        assert (name, data) == ("live", {"turn": 2})

    play(scene)


def test_a_picture_that_does_not_change_is_told_seldom(desk, folder, watcher):
    told = []
    loop = SimpleNamespace(call_soon_threadsafe=lambda call, content: told.append(content))
    teller = Teller(Stream(), loop)
    with live(desk, folder):
        watcher.turn(0.0)
        for _ in range(10):
            teller(watcher.runs, [])
        assert 2 <= len(told) <= 3
        desk.look(STATION, status(101.0))
        watcher.turn(10.0)
        teller(watcher.runs, [])
    trace = told[-1]["traces"]["G-1/run"]
    assert (trace["first"], [point[0] for point in trace["points"]]) == (1, [101.0])


def until(condition):
    while not (found := condition()):
        continue
    return found


@pytest.fixture
def tokens(tmp_path):
    file = tmp_path / "access.yaml"
    roles = ("viewer", "operator", "engineer")
    return file, {role: {"Authorization": f"Bearer {people.add_person(file, role.title(), role)}"} for role in roles}


def test_operators_act_viewers_look_and_the_run_knows_who_it_was(desk, folder, out, tokens):
    file, bearer = tokens
    with live(desk, folder), served(Settings(out=out, access=file)) as client:
        until(lambda: client.get("/api/v1/live", headers=bearer["viewer"]).json()["runs"])
        at = "/api/v1/live/G-1/run"
        assert client.get(at).status_code == 401
        assert client.get(at, headers=bearer["viewer"]).json()["state"] == "running"
        assert client.get(f"{at}/trace", headers=bearer["viewer"]).json()["next"] == 1
        refused = client.post(f"{at}/hold", headers=bearer["viewer"], json={})
        assert (refused.status_code, refused.json()["detail"]) == (403, "Viewer is viewer; this needs operator")
        assert desk._sequencer.asked == []
        answer = client.post(f"{at}/hold?wait_s=0", headers=bearer["operator"], json={}).json()
        assert (answer["asked"], answer["done"], answer["state"]) == ("hold", False, "running")
    assert desk._sequencer.asked == [("request_hold", "Operator (operator) from 127.0.0.1")]


def test_what_is_not_live_is_said_in_one_line(folder, out):
    with served(Settings(out=out)) as client:
        for method, address, code, words in (
            ("GET", "/live/G-1/run", 409, "`bench resume"),
            ("GET", "/live/G-1/run/trace", 409, "not live"),
            ("GET", "/live/G-1/run/events", 409, "not live"),
            ("POST", "/live/G-1/run/abort", 409, "not live"),
            ("GET", "/live/G-1/other", 404, "no run G-1/other"),
            ("POST", "/live/G-9/run/hold", 404, "no run G-9/run"),
            ("POST", "/live/G-1/run/explode", 422, "action"),
            ("GET", "/live/..%2F..%2Freports/G-1", 404, ""),
            ("GET", "/live/G-1/..%2F..%2Fown", 404, ""),
        ):
            answer = client.request(method, f"/api/v1{address}", json={} if method == "POST" else None)
            assert answer.status_code == code, address
            assert words in answer.json()["detail"]
            assert "\n" not in answer.json()["detail"]


def test_the_log_of_a_live_run_is_newest_first_and_without_writes(desk, folder, out, recorder):
    recorder.event("segment", "start up", phase="start", segment={"kind": "ramp", "target_degc": 33.0})
    recorder.event("write", "set point 33", register="sp", value=33.0)
    recorder.event("request", "hold", request="hold", who="Olena")
    with live(desk, folder), served(Settings(out=out)) as client:
        until(lambda: client.get("/api/v1/live").json()["runs"])
        log = client.get("/api/v1/live/G-1/run/events").json()["events"]
    assert [event["kind"] for event in log][:2] == ["request", "segment"]
    assert "write" not in {event["kind"] for event in log}
    assert (log[1]["phase"], log[1]["segment"]["target_degc"]) == ("start", 33.0)
    assert log[0]["utc"]


def test_the_log_of_a_live_run_has_the_figures_of_each_decision(desk, folder, out, recorder):
    figures = {"error_dph": 0.3, "low_dph": 0.1, "high_dph": 0.5, "seen": 1.0, "at_s": 1200.0}
    recorder.event("decision", "goes on", units={"G-1": figures}, limit_dph=0.2)
    recorder.event("unit", "two units", units=["G-1", "G-2"])
    with live(desk, folder), served(Settings(out=out)) as client:
        until(lambda: client.get("/api/v1/live").json()["runs"])
        other, decision, *_ = client.get("/api/v1/live/G-1/run/events").json()["events"]
    assert (decision["units"], decision["limit_dph"]) == ({"G-1": figures}, 0.2)
    assert other["units"] is None


@pytest.mark.parametrize("signed_in", [False, True])
def test_a_stream_ends_with_the_token_that_it_was_opened_with(out, tokens, signed_in, monkeypatch):
    monkeypatch.setattr("bench.web.live.streaming.BEAT_S", 0.02)
    file, bearer = tokens
    with served(Settings(out=out, access=file)) as client:
        if signed_in:
            token = bearer["viewer"]["Authorization"].removeprefix("Bearer ")
            client.post("/api/v1/session", json={"token": token})
        headers = {} if signed_in else bearer["viewer"]
        with client.stream("GET", "/api/v1/live/stream", headers=headers) as answer:
            lines = answer.iter_lines()
            assert [next(line for line in lines if line == "event: beat") for _ in range(2)]
            file.write_text("people: []\n")
            assert set(lines) <= {"", "event: beat", "data: {}"}  # and then it is over
        assert client.get("/api/v1/live/stream", headers=headers).status_code == 401


def test_two_browsers_see_the_same(desk, folder, out):
    with live(desk, folder), served(Settings(out=out)) as client:
        until(lambda: client.get("/api/v1/live").json()["runs"])
        seen = []
        for _ in range(2):
            with client.stream("GET", "/api/v1/live/stream?events=1") as answer:
                assert answer.headers["content-type"].startswith("text/event-stream")
                lines = [line for line in answer.iter_lines() if line.startswith("data: ")]
                seen.append(json.loads(lines[0][6:])["runs"][0])
        for picture in seen:
            picture.pop("age_s")
        assert seen[0] == seen[1]


def test_the_openapi_names_all_of_it(out):
    with served(Settings(out=out)) as client:
        paths = client.get("/api/v1/openapi.json").json()["paths"]
    for path in (
        "/live",
        "/live/stream",
        "/live/{unit}/{run}",
        "/live/{unit}/{run}/trace",
        "/live/{unit}/{run}/events",
        "/starts",
        "/plans",
        "/checks",
    ):
        assert f"/api/v1{path}" in paths


def test_the_page_knows_the_mean_of_a_point_and_that_of_half_a_minute():
    script = """
    const trace = new page.Trace();
    const span = (mean) => (mean === null ? [null, null] : [mean - 45, mean + 45, mean]);
    const points = given.map((mean, t) => [t, 20, 20, [20], [span(mean)]]);
    trace.take({ generation: 1, first: 0, next: 40, count: 40, every_s: 1, serials: ["G-1"], points });
    console.log(JSON.stringify([trace.mean[0], trace.slow[0]]));
    """
    given = [100.0] * 5 + [None] * 5 + [float(number % 2) for number in range(30)]
    mean, slow = told("lib/trace.js", script, given)
    assert mean == given  # an older bench has no means: null
    assert (slow[4], slow[9], slow[39]) == (100.0, 100.0, pytest.approx(0.5))
