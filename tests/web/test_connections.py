"""Whoever holds connections open loses them; whoever has something to say is heard. No test takes the time."""

import asyncio
import socket
import threading
from contextlib import contextmanager

import pytest
import uvicorn
from uvicorn.server import ServerState

from bench.acquisition.run.control import Desk, serve_desk
from bench.web.ground.callers import network
from bench.web.ground.settings import Settings
from bench.web.people import people
from bench.web.server import connections
from bench.web.server.connections import (
    BODY_BYTES,
    BODY_S,
    EACH,
    EACH_PERSON,
    FRESH_LOOKS,
    HEADER_S,
    STUCK_S,
    Guarded,
    Places,
)
from tests.support.web_client import served

API = "/api/v1"
REQUEST = b"POST /x HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\nContent-Length: 1000000\r\n\r\n"


class Caller:
    """A connection that remembers its end."""

    def __init__(self):
        self.dropped, self.fresh = False, True

    def drop(self):
        self.dropped = True


def come(places, count, group):
    callers = [Caller() for _ in range(count)]
    for caller in callers:
        places.come(caller, group)
    return callers


def read(*callers):
    """What they sent has been read."""
    for caller in callers:
        caller.fresh = False


def test_of_too_many_strangers_at_one_address_the_oldest_go():
    places = Places()
    others, first = come(places, 1, "other"), come(places, EACH, "a")
    read(*others, *first)
    late = come(places, 10, "a")
    assert [caller.dropped for caller in first] == [True] * 10 + [False] * (EACH - 10)
    assert not any(caller.dropped for caller in (*late, *others))


def test_a_connection_is_read_before_it_can_lose_its_place():
    places = Places()
    callers = come(places, 3 * EACH, "a")
    assert not any(caller.dropped for caller in callers)
    read(*callers)
    come(places, 1, "a")
    assert sum(caller.dropped for caller in callers) == 2 * EACH + 1
    places_left = Places(most=10)
    callers = come(places_left, 11, "a")  # the last limit holds for fresh ones, too
    assert [caller.dropped for caller in callers] == [True] + [False] * 10


def test_whoever_was_recognised_keeps_the_place():
    places = Places(most=EACH + 1)
    (person,) = come(places, 1, "a")
    places.recognise(person, "Olena")
    read(person)
    for _ in range(5):
        read(*come(places, EACH, "a"))
    assert not person.dropped


def test_a_person_has_places_too_and_takes_none_of_the_others():
    """A stolen token fills its own places, and its owner's newest connection is heard all the same."""
    places = Places()
    (other,) = come(places, 1, "a")
    places.recognise(other, "Olena")
    thief = come(places, EACH_PERSON, "b")
    for caller in thief:
        places.recognise(caller, "line-3")
    read(other, *thief)
    (owner,) = come(places, 1, "c")
    places.recognise(owner, "line-3")
    assert [caller.dropped for caller in thief] == [True] + [False] * (EACH_PERSON - 1)
    assert not any(caller.dropped for caller in (owner, other))


def test_when_the_server_is_full_the_address_with_the_most_connections_loses_one():
    places = Places(most=50)
    few, many, new = come(places, 10, "few"), come(places, 40, "many"), come(places, 5, "new")
    assert not any(caller.dropped for caller in (*few, *new))
    assert sum(caller.dropped for caller in many) == 5


def test_places_of_those_who_left_are_free_and_nothing_is_kept_of_them():
    places = Places(most=4)
    for _ in range(10):
        callers = come(places, 4, "a")
        for caller in callers:
            places.go(caller)
        assert not any(caller.dropped for caller in callers)
    assert places._held == {}
    assert places._holders == {}


def test_an_address_may_be_without_a_limit():
    places = Places(unbounded={"proxy"})
    first = come(places, EACH, "proxy")
    read(*first)
    come(places, EACH, "proxy")
    assert not any(caller.dropped for caller in first)


@pytest.mark.parametrize(
    ("address", "group"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("unknown", "unknown"),
    ],
)
def test_limits_count_a_host_and_not_its_many_addresses(address, group):
    assert network(address) == group


class Transport:
    """A wire of which nothing is read."""

    def __init__(self):
        self.written, self.aborted, self.closing = b"", False, False

    def get_extra_info(self, name, default=None):
        return ("127.0.0.1", 5) if name in {"peername", "sockname"} else default

    def get_write_buffer_size(self):
        return len(self.written)

    def write(self, data):
        self.written += data

    def abort(self):
        self.aborted = True

    def close(self):
        self.closing = True

    def is_closing(self):
        return self.closing

    def pause_reading(self):
        pass

    resume_reading = pause_reading


@contextmanager
def connected(app):
    """A connection inside a running loop, by itself."""
    config = uvicorn.Config(app, log_config=None)
    connection = Guarded(config, ServerState(), {}, places=Places())
    transport = Transport()
    connection.connection_made(transport)
    yield connection, transport


async def reads(scope, receive, send):
    while (await receive()).get("more_body"):
        pass


async def talks(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"x" * 100, "more_body": True})
    await asyncio.Event().wait()


def passes(connection, seconds):
    for _ in range(int(seconds)):
        connection.look(1.0)


async def settled():
    for _ in range(10):
        await asyncio.sleep(0)


@pytest.mark.parametrize(("said", "more"), [(b"", b""), (b"G", b"E"), (b"GET / HTTP/1.1\r\nHost: a\r\nX-Slow: ", b"a")])
def test_headers_that_do_not_come_end_the_connection(said, more):
    async def trial():
        with connected(reads) as (connection, transport):
            for part in (said, more):  # a byte now and then is no help
                if part:
                    connection.data_received(part)
                assert not transport.aborted
                passes(connection, HEADER_S / 2 + 1)
            assert transport.aborted

    asyncio.run(trial())


def test_a_body_that_does_not_come_ends_the_connection_and_a_slow_one_does_not():
    async def trial():
        for each, ended in ((1, True), (10, True), (3 * BODY_BYTES, False)):
            with connected(reads) as (connection, transport):
                connection.data_received(REQUEST)
                await settled()
                for _ in range(int(3 * BODY_S)):
                    connection.data_received(b"x" * each)
                    await settled()
                    connection.look(1.0)
                assert transport.aborted is ended, each
                connection.connection_lost(None)
                await settled()

    asyncio.run(trial())


def test_a_connection_is_fresh_until_it_was_looked_at():
    async def trial():
        with connected(reads) as (connection, _):
            for _ in range(FRESH_LOOKS):
                assert connection.fresh
                connection.look(1.0)
            assert not connection.fresh

    asyncio.run(trial())


def test_an_answer_that_nobody_reads_ends_the_connection():
    async def trial():
        with connected(talks) as (connection, transport):
            connection.data_received(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
            await settled()
            passes(connection, STUCK_S)
            assert transport.written
            assert not transport.aborted
            passes(connection, 3)
            assert transport.aborted

    asyncio.run(trial())


def test_a_stream_that_is_read_stays():
    async def trial():
        with connected(talks) as (connection, transport):
            connection.data_received(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
            await settled()
            transport.written = b""
            passes(connection, 10 * STUCK_S)
            assert not transport.aborted

    asyncio.run(trial())


class Sequencer:
    """Remembers who wanted it to stop."""

    def __init__(self):
        self.stopped = []

    def request_stop(self, cause):
        self.stopped.append(cause)


@contextmanager
def held(address, sent, count):
    """So many connections on which this was sent, and then nothing."""
    found = []
    try:
        for _ in range(count):
            found.append(socket.create_connection(address))
            if sent:
                found[-1].sendall(sent)
        yield
    finally:
        for connection in found:
            connection.close()


UPLOAD = (
    b"POST /api/v1/imports HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Bench: 1\r\nContent-Length: 100000\r\n"
    b"Content-Type: multipart/form-data; boundary=b\r\n\r\n"
    b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\ntime'
)
KINDS = {
    "idle": b"",
    "slow headers": b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ",
    "slow bodies": b"POST /api/v1/session HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    b"Content-Length: 1000\r\n\r\n{",
    "abandoned uploads": UPLOAD,
}


@pytest.mark.parametrize("kind", KINDS)
def test_three_hundred_connections_without_a_token_do_not_close_the_page(kind, tmp_path):
    path, out = tmp_path / "access.yaml", tmp_path / "out"
    token = people.add_person(path, "Olena", "operator")
    folder = out / "U" / "run"
    folder.mkdir(parents=True)
    (folder / "profile.yaml").write_text("name: p\nsegments:\n  - {kind: soak, duration_min: 5}\n")
    desk, sequencer = Desk(), Sequencer()
    desk.attach(sequencer, 100.0)
    with serve_desk(desk, [folder]), served(Settings(out, access=path)) as client:
        address = client.base_url.host, client.base_url.port
        with held(address, KINDS[kind], 300):
            client.headers["Authorization"] = f"Bearer {token}"
            assert client.get("/").status_code == 200
            while not client.get(f"{API}/live").json()["runs"]:
                pass
            answer = client.post(f"{API}/live/U/run/abort?wait_s=0", json={})
            assert answer.status_code == 200, answer.text
    assert len(sequencer.stopped) == 1
    assert "Olena" in sequencer.stopped[0]


def test_a_stranger_is_refused_before_the_body(tmp_path):
    path = tmp_path / "access.yaml"
    people.add_person(path, "Olena", "operator")
    with served(Settings(tmp_path / "out", access=path)) as client:
        with socket.create_connection((client.base_url.host, client.base_url.port)) as connection:
            connection.sendall(UPLOAD)
            assert b" 401 " in connection.recv(4096).partition(b"\r\n")[0]
        assert not (tmp_path / "out" / ".web" / "imports").exists()


def test_an_abort_does_not_wait_for_what_others_ask(tmp_path, monkeypatch):
    """Every thread of the server that answers is busy; the abort has its own."""
    folder = tmp_path / "U" / "run"
    folder.mkdir(parents=True)
    (folder / "profile.yaml").write_text("name: p\nsegments:\n  - {kind: soak, duration_min: 5}\n")
    desk, sequencer = Desk(), Sequencer()
    desk.attach(sequencer, 100.0)
    with serve_desk(desk, [folder]), served(Settings(tmp_path)) as client:
        while not client.get(f"{API}/live").json()["runs"]:
            pass
        address = client.base_url.host, client.base_url.port
        begun, go_on = threading.Semaphore(0), threading.Event()

        def waits(*_):
            begun.release()
            go_on.wait(60)
            return {}

        monkeypatch.setattr("bench.web.plans.catalog.Catalog.limits", waits)
        ask = f"GET {API}/limits HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
        try:
            with held(address, ask, 60):
                for _ in range(40):
                    begun.acquire()
                answer = client.post(f"{API}/live/U/run/abort?wait_s=0", json={})
                assert answer.status_code == 200
                assert len(sequencer.stopped) == 1
        finally:
            go_on.set()


def test_there_is_room_for_many_connections_and_files():
    assert EACH <= connections.room() <= connections.MOST
