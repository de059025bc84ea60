"""Live runs at browsers: mirrored, streamed to slow ones and fast ones, acted on by those who may."""

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.acquisition.recording.trace import Trace
from bench.web.ground.settings import Settings
from bench.web.live.mirror import Mirror
from bench.web.live.starts import Starts
from bench.web.live.streaming import KEPT, KEPT_ENDS, Stream
from bench.web.live.telling import Teller
from bench.web.people import people
from tests.acquisition.test_control import STATION, status
from tests.support.live_desk import live
from tests.support.page_modules import told
from tests.support.servers import site_over
from tests.support.web_client import served


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


def test_the_stream_ends_with_the_server_and_nothing_of_it_is_cut_off(tmp_path):
    with site_over(tmp_path) as site, httpx.stream("GET", f"{site.address}/api/v1/live/stream", timeout=60) as answer:
        lines = answer.iter_lines()
        assert next(lines).startswith("retry: ")
        site.end()
        assert not [line for line in lines if line.startswith("retry: ")]  # its end, and no error that it is incomplete


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
        named = client.post(f"{at}/hold?wait_s=0", headers=bearer["operator"], json={"operator": "Olena"})
        assert (named.status_code, "signed in" in named.json()["detail"]) == (400, True)
    assert desk._sequencer.asked == [("request_hold", "Operator (operator) from 127.0.0.1")]


def test_where_nobody_signs_in_a_run_is_asked_by_who_is_named_else_by_who_started_it(desk, folder, out, monkeypatch):
    start = {"start": "s", "who": {"name": "Olena"}, "digest": "", "plan": "p", "station": "s", "units": []}
    monkeypatch.setattr(Starts, "saw", lambda self, pid, runs: start)
    with live(desk, folder), served(Settings(out=out)) as client:
        until(lambda: client.get("/api/v1/live").json()["runs"])
        for body in ({"operator": "Ivan"}, {}):
            assert client.post("/api/v1/live/G-1/run/hold?wait_s=0", json=body).status_code == 200
    names = ("Ivan", "Olena")
    assert desk._sequencer.asked == [("request_hold", f"{name} (engineer) from 127.0.0.1") for name in names]


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


def test_a_page_that_was_open_before_the_first_point_tells_the_units_apart():
    script = """
    const trace = new page.Trace();
    for (const increment of given) trace.take(increment);
    console.log(JSON.stringify(["G-1", "G-2"].map((serial) => trace.mean[trace.place(serial)])));
    """
    trace, units = Trace(origin=1), [("G-1", 20.0, (1.0, 1.0, 1.0, 1)), ("G-2", 20.0, (2.0, 2.0, 2.0, 1))]
    given = [trace.since()]
    trace.add(0.0, (20.0, 20.0), units)
    given.append(trace.since(0, given[0]["generation"]))
    assert told("lib/trace.js", script, given) == [[1.0], [2.0]]
