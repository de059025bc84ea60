"""A live run seen and steered from outside: the desk, its server, and what happens to clients that talk nonsense."""

import json
import os
import socket
import stat
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from bench.acquisition.profile.guards import Guards, GuardSettings, Signal
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.recording.trace import Envelope
from bench.acquisition.run import control, remote
from bench.acquisition.run.control import Desk
from bench.acquisition.run.status import Status
from bench.base.errors import EquipmentError, InputError
from bench.cli.rendering.live import live_run
from drivers.canbus import CaptureHealth
from drivers.chamber import ChamberReading

PROFILE = profile_from_text(
    "name: p\nsegments:\n  - {kind: ramp, to_degc: 33, rate_degc_per_min: 2}\n  - {kind: soak, duration_min: 10}\n"
)
LOSSES = SimpleNamespace(as_dict=lambda: {"received": 6010, "lost": 3})
UNIT = SimpleNamespace(
    serial="G-1",
    temperature=SimpleNamespace(value=float("nan")),
    decoder=SimpleNamespace(losses=LOSSES),
    rates=Envelope(),
)
BUS = CaptureHealth(1200, 99.9, bus="can0", behind_s=0.3104, most_behind_s=1.5)
STATION = SimpleNamespace(units=[UNIT], dropped=[], captures=lambda: [BUS])


def test_status_shows_how_far_the_capture_is_behind_each_bus(desk):
    desk.look(STATION, status())
    (bus,) = desk.status()["buses"]
    assert bus == {"bus": "can0", "state": "ok", "frames": 1200, "behind_s": 0.31, "most_behind_s": 1.5}
    told = live_run({"run": "r", **desk.status()})
    assert "  bus      can0: ok, 1200 frames, 0.31 s behind, at most 1.50 s" in list(told)


class Sequencer:
    """Remembers what it was asked for."""

    def __init__(self):
        self.asked = []

    def __getattr__(self, name):
        return lambda cause: self.asked.append((name, cause))


def status(t_s=100.0, holding=()):
    reading = ChamberReading(t_s, 25.04, 33.0, 25.1, 10.0, True, (), False)
    return Status(t_s, PROFILE.legs()[0], 0.0, 2, reading, 24.567, holding)


@pytest.fixture
def sequencer():
    return Sequencer()


@pytest.fixture
def desk(sequencer):
    desk = Desk()
    desk.attach(sequencer, PROFILE.duration_s)
    return desk


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "G-1" / "run"
    path.mkdir(parents=True)
    return path


@pytest.fixture
def live(desk, folder):
    with control.serve_desk(desk, [folder]) as trouble:
        assert trouble == ""
        yield remote.live_at(folder)


def say(run, data, patience_s=5.0):
    """What the server answers to these bytes; nothing when it closes the connection."""
    with socket.create_connection((remote.HOST, run.file.port), patience_s) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        while part := connection.recv(4096):
            answer += part
        return answer


def test_status_is_the_newest_tick(desk, live):
    assert remote.ask_run(live, "status")["state"] == "starting"
    desk.look(STATION, status(100.0, holding=("too hot: unit temperature = 90 degC is above 85 degC",)))
    answer = remote.ask_run(live, "status")
    assert answer["t_s"] == 100.0
    assert answer["segment"]["name"] == "ramp to 33 at 2"
    assert (answer["segment"]["left_s"], answer["left_s"]) == (200.0, 800.0)
    assert answer["chamber"]["temperature_degc"] == 25.04
    assert answer["units"] == [
        {"serial": "G-1", "temperature_degc": None, "losses": {"received": 6010, "lost": 3}, "dropped": None}
    ]
    assert answer["holding"] == ["too hot: unit temperature = 90 degC is above 85 degC"]
    assert 0 <= answer["age_s"] < 5


def test_status_shows_the_guards_as_lights(sequencer, folder):
    rules = [
        GuardSettings(name="hot", signal="unit_temperature", above=60.0, delay_s=5.0),
        GuardSettings(name="door", signal="door", above=0.5, action="hold"),
        GuardSettings(name="disk", signal="disk_free_mb", below=100.0),
    ]
    guards, desk = Guards(rules), Desk()
    desk.attach(sequencer, PROFILE.duration_s, guards)
    signals = {"unit_temperature": 61.5, "door": 1.0, "disk_free_mb": 5e5}
    guards.evaluate({name: Signal(value, 100.0) for name, value in signals.items()}, 100.0)
    desk.look(STATION, status())
    with control.serve_desk(desk, [folder]):
        lights = remote.ask_run(remote.live_at(folder), "status")["guards"]
    assert [(light["name"], light["state"], light["action"]) for light in lights] == [
        ("hot", "waiting", "abort"),
        ("door", "tripped", "hold"),
        ("disk", "ok", "abort"),
    ]
    assert lights[0]["text"] == "unit temperature = 61.5 degC is above 60 degC"
    assert (lights[0]["value"], lights[2]["text"]) == (61.5, "")


def test_status_says_how_far_the_estimate_was_off_so_far(desk):
    desk.look(STATION, status(10.0))
    assert desk.status()["late_s"] == 0.0
    desk.look(STATION, status(200.0))
    assert desk.status()["late_s"] == 0.0
    desk.look(STATION, status(430.0))  # the ramp was to take 300 s
    assert desk.status()["late_s"] == 130.0


def test_the_trace_comes_with_the_status_and_only_what_is_new(desk, live):
    UNIT.rates.add(np.array([-5.0, 7.25]))
    desk.look(STATION, status(100.0))
    answer = remote.ask_run(live, "trace")
    assert (answer["t_s"], answer["trace"]["serials"]) == (100.0, ["G-1"])
    assert answer["trace"]["points"] == [[100.0, 25.1, 25.04, [None], [[-5.0, 7.25, 1.125]]]]
    desk.look(STATION, status(101.0))
    known = {"since": answer["trace"]["next"], "generation": answer["trace"]["generation"]}
    (news,) = remote.ask_run(live, "trace", **known)["trace"]["points"]
    assert (news[0], news[4]) == (101.0, [[None, None, None]])


@pytest.mark.parametrize("since", [None, "x", -1, 1e300, [], True])
def test_nonsense_about_the_trace_is_answered_from_the_beginning(desk, live, since):
    desk.look(STATION, status())
    assert remote.ask_run(live, "trace", since=since, generation=since)["trace"]["first"] == 0


def test_who_asks_may_be_somebody_else_than_the_user_of_the_process(live, sequencer):
    remote.ask_run(live, "hold", who="Olena (operator, 10.0.0.7)")
    assert sequencer.asked == [("request_hold", "Olena (operator, 10.0.0.7)")]


@pytest.mark.parametrize(
    ("action", "request_"),
    [("hold", "request_hold"), ("pause", "request_pause"), ("resume", "request_resume"), ("abort", "request_stop")],
)
def test_each_action_reaches_the_sequencer_with_who_asked(live, sequencer, action, request_):
    remote.ask_run(live, action)
    assert sequencer.asked == [(request_, remote.whoami())]


def test_an_aborted_run_says_that_it_is_ending(desk, live):
    desk.look(STATION, status())
    remote.ask_run(live, "abort")
    desk.look(STATION, status(101.0))
    assert remote.ask_run(live, "status")["state"] == "ending"


def test_nothing_can_be_asked_before_there_is_a_sequencer(folder):
    with control.serve_desk(Desk(), [folder]), pytest.raises(InputError, match="only just starting"):
        remote.ask_run(remote.live_at(folder), "hold")


def test_the_file_is_for_its_owner_alone_and_goes_with_the_run(desk, folder):
    with control.serve_desk(desk, [folder]):
        file = folder / remote.LIVE
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert json.loads(file.read_text())["pid"] == os.getpid()
        assert remote.live_at(folder).file.token not in repr(remote.live_at(folder))
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("token", ["", "wrong", None, 5, ["x"], "ü\ud800"])
def test_a_wrong_token_is_refused_and_nothing_is_done(live, sequencer, token):
    answer = json.loads(say(live, json.dumps({"token": token, "do": "abort"}).encode() + b"\n"))
    assert answer["ok"] is False
    assert "wrong token" in answer["error"]
    assert "state" not in answer
    assert sequencer.asked == []


@pytest.mark.parametrize(
    "data",
    [b"", b"\n", b"\x00\xff\xfe\n", b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"[" * 5000 + b"\n", b"1e999\n", b'"x"\n',
     b"{" * 100_000, b'{"token": ', b"null\n"],
)  # fmt: skip
def test_garbage_changes_nothing(live, sequencer, capfd, data):
    answer = say(live, data) if len(data) < remote.LIMIT_BYTES else shout(live, data)
    assert answer == b"" or json.loads(answer)["ok"] is False
    assert remote.ask_run(live, "status")["ok"]
    assert sequencer.asked == []
    assert capfd.readouterr() == ("", "")


def shout(run, data):
    try:
        return say(run, data)
    except OSError:  # closed on us in the middle of it
        return b""


def test_an_action_that_does_not_exist_is_answered_with_those_that_do(live):
    with pytest.raises(InputError, match="must be one of status, trace, hold, pause, resume, abort"):
        remote.ask_run(live, "explode")


def test_a_name_cannot_forge_a_line_of_the_record(live, sequencer):
    request = {"token": live.file.token, "do": "hold", "who": "eve\n{}\x1b[2J" + "x" * 5000}
    say(live, json.dumps(request).encode() + b"\n")
    ((_, cause),) = sequencer.asked
    assert cause.isprintable()
    assert len(cause) < 200


def test_clients_that_say_nothing_keep_nobody_out(live, sequencer):
    idle = [socket.create_connection((remote.HOST, live.file.port)) for _ in range(10 * control.CLIENTS)]
    try:
        assert remote.ask_run(live, "abort")["ok"]
    finally:
        for connection in idle:
            connection.close()
    assert [name for name, _ in sequencer.asked] == ["request_stop"]


def test_clients_that_say_nothing_are_turned_away_and_hold_few_threads(live):
    idle = [socket.create_connection((remote.HOST, live.file.port)) for _ in range(2 * control.CLIENTS)]
    try:
        threads = {thread.name for thread in threading.enumerate() if "process_request" in thread.name}
        assert len(threads) <= control.CLIENTS
    finally:
        for connection in idle:
            connection.close()
    answer = {}
    while not answer.get("ok"):  # the places of those that have left become free
        try:
            answer = remote.ask_run(live, "status")
        except EquipmentError:
            continue
    assert answer["ok"]


def test_a_file_of_a_dead_process_is_recognised(desk, folder, tmp_path):
    with control.serve_desk(desk, [folder]):
        text = (folder / remote.LIVE).read_text()
    (folder / remote.LIVE).write_text(text)
    assert remote.live_at(folder).condition() == "gone"
    with pytest.raises(InputError, match=r"its process \d+ is gone; `bench resume"):
        remote.only_live_run(folder, tmp_path)
    with pytest.raises(InputError, match="no live run here"):
        remote.only_live_run(None, tmp_path)


def test_a_port_that_somebody_else_has_now_is_no_live_run(desk, live, tmp_path):
    other = tmp_path / "G-1" / "older"
    other.mkdir()
    content = json.loads((live.path / remote.LIVE).read_text()) | {"token": "of another time"}
    (other / remote.LIVE).write_text(json.dumps(content))
    assert remote.live_at(other).condition() == "gone"
    assert remote.only_live_run(None, tmp_path).path == live.path


def test_a_process_that_does_not_answer_is_not_taken_for_dead(live, monkeypatch):
    monkeypatch.setattr(remote, "ANSWER_S", 0.1)
    monkeypatch.setattr(remote.ask_run, "__defaults__", (0.1,))
    with socket.create_server((remote.HOST, 0)) as deaf:
        run = remote.LiveRun(live.folders, remote.LiveFile(1, deaf.getsockname()[1], "", [], "t"))
        assert run.condition() == "silent"


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"pid": "x"}', "\x00"])
def test_a_spoilt_file_is_no_live_run(folder, tmp_path, text):
    (folder / remote.LIVE).write_text(text)
    assert remote.live_at(folder) is None
    assert remote.live_below(tmp_path) == []


def test_two_live_runs_are_listed_and_one_must_be_named(desk, live, tmp_path):
    other = tmp_path / "G-2" / "run"
    other.mkdir(parents=True)
    with control.serve_desk(Desk(), [other]):
        with pytest.raises(InputError, match=r"2 live runs here; name one of .*G-1/run, .*G-2/run"):
            remote.only_live_run(None, tmp_path)
        assert remote.only_live_run(other, tmp_path).path == other


def test_folders_of_several_units_are_one_run(desk, tmp_path):
    folders = [tmp_path / unit / "run" for unit in ("G-1", "G-2")]
    for folder in folders:
        folder.mkdir(parents=True)
    with control.serve_desk(desk, folders):
        (run,) = remote.live_below(tmp_path)
        assert run.folders == tuple(folders)
        assert remote.only_live_run(folders[1], tmp_path).file == run.file


def test_a_run_without_a_port_goes_on_and_says_so(desk, folder, monkeypatch):
    def taken(*args):
        raise OSError(98, "Address already in use")

    monkeypatch.setattr(control._Server, "server_bind", taken)
    with control.serve_desk(desk, [folder]) as trouble:
        assert trouble == "no control from other processes: Address already in use"
    assert list(folder.iterdir()) == []
