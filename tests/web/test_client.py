"""`bench status`, `hold`, `pause`, `resume` and `abort` with `--server`: a run by the API of `bench ui`."""

import http.server
import json
import socket
import threading

import pytest
from click.testing import CliRunner

from bench.cli import main, rendering
from bench.commands import Aborted
from bench.record.folder import open_run
from bench.web.ground.settings import Settings
from bench.web.people import people
from tests.commands.test_live import PROFILE, start
from tests.support.waiting import until
from tests.support.web_client import served


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A long run of the simulator, a server that asks for tokens, and the tokens of a viewer and an operator."""
    profile, out, access = tmp_path / "long.yaml", tmp_path / "reports", tmp_path / "access.yaml"
    profile.write_text(PROFILE)
    tokens = {role: people.add_person(access, f"the {role}", role) for role in ("viewer", "operator")}
    process = start("run", profile, "--out", out, "--model", "polynomial", "--quiet")
    try:
        with served(Settings(out, project=tmp_path, access=access)) as client:
            monkeypatch.setenv("BENCH_SERVER", str(client.base_url))
            until(lambda: any("segment" in run for run in asked(tokens["viewer"], "status")["runs"]))
            yield process, out, tokens
    finally:
        process.kill()
        process.communicate()


def bench(token, *arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments], env={"BENCH_TOKEN": token})


def asked(token, *arguments):
    answer = bench(token, *arguments, "--json")
    assert answer.exit_code == 0, answer.output
    return json.loads(answer.stdout)


@pytest.mark.slow
def test_an_operator_steers_a_run_through_the_server_and_stands_in_its_events(site):
    process, out, tokens = site
    operator, viewer = tokens["operator"], tokens["viewer"]
    (live,) = asked(viewer, "status")["runs"]
    assert "this needs operator" in bench(viewer, "abort").stderr
    assert "put it into BENCH_TOKEN" in bench("", "status").stderr
    assert asked(operator, "hold")["state"] == "holding"
    assert asked(operator, "resume", out / live["run"])["state"] == "running"  # a path to it names it, too
    assert asked(operator, "pause", live["run"])["state"] in {"pausing", "holding"}
    ended = bench(operator, "abort")
    assert ended.exit_code == 0, ended.output
    assert "aborted by the operator (operator) from 127.0.0.1" in ended.stdout
    assert "ok    chamber off" in ended.stdout
    process.communicate()
    assert process.returncode == 3
    requests = [event for event in open_run(out / live["run"]).events() if event["kind"] == "request"]
    assert [event["request"] for event in requests] == ["hold", "resume", "pause", "stop"]
    assert all("the operator (operator) from 127.0.0.1" in event["who"] and event["utc"] for event in requests)
    assert bench(operator, "hold").exit_code == 2
    assert asked(viewer, "status") == {"runs": []}


@pytest.mark.parametrize(
    ("url", "code", "words"),
    [
        ("ftp://127.0.0.1", 2, "must be like http://127.0.0.1:8321"),
        ("http://anna:secret@127.0.0.1", 2, "BENCH_TOKEN"),
        ("http://127.0.0.1:1", 4, "is `bench ui` running there?"),
    ],
)
def test_a_server_that_is_none_is_said_in_one_line(url, code, words):
    answer = bench("", "status", "--server", url)
    assert answer.exit_code == code
    assert words in answer.stderr
    assert answer.stderr.count("\n") == 1


@pytest.mark.parametrize("said", [b"SSH-2.0-OpenSSH_9.2\r\n", b'HTTP/1.0 200 OK\r\n\r\n{"status": "up"}'])
def test_a_server_of_another_kind_is_said_in_one_line(said):
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer():
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(said)

        thread = threading.Thread(target=answer)
        thread.start()
        told = bench("", "status", "--server", f"http://127.0.0.1:{listener.getsockname()[1]}")
        thread.join()
    assert told.exit_code == 4
    assert (told.stderr.count("\n"), "of a bench" in told.stderr) == (1, True)


def test_of_an_end_that_nobody_saw_nothing_good_is_said():
    told = Aborted({"run": "G-1/r", "cause": "the bench was killed", "safe": None, "safe_state": []})
    assert told.exit_code == 4
    assert "nothing had moved" not in rendering.plain(told)
    assert "SAFE STATE NOT VERIFIED" in rendering.plain(told)


def test_a_token_is_not_carried_on_to_where_a_server_points():
    seen = []

    class Pointing(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            seen.append(self.path)
            self.send_response(302)
            self.send_header("Location", "/elsewhere")
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Pointing) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            answer = bench("secret", "status", "--server", f"http://127.0.0.1:{server.server_port}")
        finally:
            server.shutdown()
            thread.join()
    assert answer.exit_code == 2
    assert seen == ["/api/v1/live"]
