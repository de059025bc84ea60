"""Nobody gets in: tokens, roles, sessions, foreign pages and hosts, sizes, and the headers of every answer."""

import hashlib
import os
import socket
import ssl
import subprocess
from pathlib import Path

import httpx
import pytest
from click.testing import CliRunner

from bench.base.errors import InputError
from bench.cli import main
from bench.web.ground import policy
from bench.web.ground.settings import Settings
from bench.web.ground.throttle import EACH_S, TRIES, Throttle
from bench.web.people import people
from bench.web.people.people import People
from bench.web.people.sessions import LIFE_S, Sessions
from bench.web.server.serving import Tls
from tests.support.web_client import served

API = "/api/v1"
JSON = {"Content-Type": "application/json"}
ROLES = ("viewer", "operator", "engineer")
PAGES = ("/", "/live", "/workbench", "/units", "/units/SIM-0001", "/fleet", "/login")


@pytest.fixture(scope="module")
def tokens(tmp_path_factory):
    """The access file of three people, and their tokens by role."""
    path = tmp_path_factory.mktemp("access") / "access.yaml"
    return path, {role: people.add_person(path, f"{role} one", role) for role in ROLES}


@pytest.fixture(scope="module")
def guarded(tokens, tmp_path_factory):
    """A client of a server that asks for tokens, and the tokens."""
    path, known = tokens
    with served(Settings(tmp_path_factory.mktemp("out"), access=path)) as client:
        yield client, known


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """A client of a server of this machine alone."""
    with served(Settings(tmp_path_factory.mktemp("out"), body_bytes=4096)) as client:
        yield client


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


def refused(answer, status):
    assert answer.status_code == status, answer.text
    (detail,) = answer.json().values()
    assert "\n" not in detail
    return detail


def operations(client):
    paths = client.get(f"{API}/openapi.json").json()["paths"]
    return [(method, path) for path, item in paths.items() for method in item]


def bench(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


# Who


def test_on_this_machine_everybody_is_an_engineer_by_the_name_of_its_user(opened):
    session = opened.get(f"{API}/session").json()
    assert session["role"] == "engineer"
    assert session["name"]
    assert session["open"] is True


@pytest.mark.slow
def test_without_a_token_nothing_of_the_api_answers_but_the_question_who_am_i(guarded):
    client, _ = guarded
    assert client.get(f"{API}/session").json() | {"version": ""} == {
        "name": None, "role": None, "version": "", "languages": ["en", "uk", "zh"], "open": False,
        "pins": False, "pin_s": None,
    }  # fmt: skip
    found = operations(client)
    assert len(found) > 10
    for method, path in found:
        if not path.endswith("/session"):
            detail = refused(client.request(method, path, headers=JSON), 401)
            assert "Authorization: Bearer" in detail


def test_a_viewer_changes_nothing_and_an_operator_computes_nothing(guarded):
    client, known = guarded
    changing = [(method, path) for method, path in operations(client) if method != "get" and "session" not in path]
    assert len(changing) > 10
    for method, path in changing:
        if path.endswith(("/figures", "/formula")):  # looking; the question is long
            continue
        refused(client.request(method, path, headers=JSON | bearer(known["viewer"])), 403)
    for path in ("/analyses", "/differences", "/diagnoses", "/models", "/registry"):
        kind = {"headers": JSON | bearer(known["operator"])}
        assert "this needs engineer" in refused(client.post(API + path, **kind), 403)


def test_a_token_is_exchanged_for_a_cookie_that_scripts_and_other_sites_do_not_get(guarded):
    client, known = guarded
    answer = client.post(f"{API}/session", json={"token": known["operator"]})
    assert answer.json()["role"] == "operator"
    cookie = answer.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert known["operator"] not in cookie
    assert client.get(f"{API}/session").json()["name"] == "operator one"
    kept = cookie.partition(";")[0]
    client.delete(f"{API}/session")
    assert not client.cookies
    assert client.get(f"{API}/session", headers={"Cookie": kept}).json()["name"] is None  # worth nothing any more


def test_a_pin_names_the_operator_of_a_screen_for_a_while_and_gives_no_more(tmp_path):
    path = tmp_path / "access.yaml"
    kiosk = people.add_person(path, "kiosk", "viewer")
    pin = people.add_pin(path, "Olena", "operator")
    people.add_pin(path, "Ivan", "engineer", badge="0004471199")
    assert pin not in path.read_text()
    with pytest.raises(InputError, match="that of Ivan"):
        people.add_pin(path, "Petro", "operator", badge="0004471199")
    with served(Settings(tmp_path / "out", access=path)) as client:
        assert client.post(f"{API}/session/pin", json={"pin": pin}).status_code == 401  # nobody has signed in there
        client.post(f"{API}/session", json={"token": kiosk})
        assert client.delete(f"{API}/starts/none").status_code == 403
        assert client.post(f"{API}/session/pin", json={"pin": "000"}).status_code == 401
        assert client.post(f"{API}/session/pin", json={"pin": pin}).status_code == 204
        who = client.get(f"{API}/session").json()
        assert (who["name"], who["role"], who["pins"], 800 < who["pin_s"] <= 900) == ("Olena", "operator", True, True)
        assert client.delete(f"{API}/starts/none").status_code == 404  # she may
        moved = next(value for name, value in client.cookies.items() if name.endswith("-pin"))
        base = next(name for name in client.cookies if not name.endswith("-pin"))
        alone = httpx.get(f"{client.base_url}{API}/session", headers={"Cookie": f"{base}={moved}"}, trust_env=False)
        assert alone.json()["name"] is None  # worth nothing as a session of its own
        assert client.delete(f"{API}/session/pin").status_code == 204
        assert client.get(f"{API}/session").json()["name"] == "kiosk"
        assert client.post(f"{API}/session/pin", json={"pin": "0004471199"}).status_code == 204
        assert client.get(f"{API}/session").json()["role"] == "operator"  # no engineer by a badge
        for _ in range(TRIES):
            client.post(f"{API}/session/pin", json={"pin": "1111"})
        assert client.post(f"{API}/session/pin", json={"pin": pin}).status_code == 429


def test_sessions_outlast_the_server_and_end_with_the_shift_or_the_token(tokens, tmp_path):
    path, known = tokens
    now = [1000.0]
    person = People(path).by_token(known["viewer"])
    key = Sessions(tmp_path / "sessions.json", lambda: now[0]).begin(person)
    again = Sessions(tmp_path / "sessions.json", lambda: now[0])
    assert again.token(key) == person.token_sha256
    assert key not in (tmp_path / "sessions.json").read_text()
    now[0] += LIFE_S
    assert again.token(key) is None
    (tmp_path / "sessions.json").write_text("[nonsense")
    assert Sessions(tmp_path / "sessions.json").token(key) is None


def test_on_a_full_disk_an_operator_still_signs_in(tokens, tmp_path, monkeypatch):
    path, known = tokens

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("bench.web.people.sessions.write_atomically", full)
    with served(Settings(tmp_path, access=path)) as client:
        assert client.post(f"{API}/session", json={"token": known["operator"]}).json()["role"] == "operator"
        assert client.get(f"{API}/session").json()["role"] == "operator"


def test_a_token_that_is_taken_out_of_the_file_is_not_valid_from_then_on(tmp_path):
    path = tmp_path / "access.yaml"
    token = people.add_person(path, "Anna", "engineer")
    known = People(path)
    assert known.by_token(token).name == "Anna"
    path.write_text("people: []\n")
    assert known.by_token(token) is None


def test_wrong_tokens_are_slowed_down_for_their_address_alone(tokens, tmp_path):
    path, known = tokens
    with served(Settings(tmp_path, access=path)) as client:
        for _ in range(TRIES):
            refused(client.get(f"{API}/runs", headers=bearer("wrong")), 401)
        answer = client.post(f"{API}/session", json={"token": "wrong again"})
        assert "too many wrong tokens from 127.0.0.1" in refused(answer, 429)
        assert 0 < int(answer.headers["retry-after"]) <= EACH_S
        assert client.get(f"{API}/runs", headers=bearer(known["viewer"])).status_code == 200  # whoever has one goes on
    now = [0.0]
    throttle = Throttle(lambda: now[0])
    for _ in range(TRIES):
        throttle.wrong("10.0.0.1")
    assert throttle.wait_s("10.0.0.1") == EACH_S
    assert throttle.wait_s("10.0.0.2") == 0
    now[0] += EACH_S
    assert throttle.wait_s("10.0.0.1") == 0


def test_behind_one_address_a_wrong_token_slows_wrong_tokens_and_no_right_one(tokens, tmp_path):
    """Those behind a proxy that is named are told apart; those behind another shared address are not, and get in."""
    path, known = tokens
    behind = {"X-Forwarded-For": "192.0.2.1", "X-Forwarded-Proto": "https"}
    with served(Settings(tmp_path, access=path), behind="127.0.0.1") as client:
        for _ in range(TRIES):
            refused(client.get(f"{API}/runs", headers=bearer("wrong") | behind), 401)
        detail = refused(client.get(f"{API}/runs", headers=bearer("wrong") | behind), 429)
        assert "from 192.0.2.1" in detail
        assert "a right one is accepted at once" in detail
        other = {"X-Forwarded-For": "192.0.2.2"}
        refused(client.get(f"{API}/runs", headers=bearer("wrong") | other), 401)
        assert client.get(f"{API}/runs", headers=bearer(known["viewer"]) | behind).status_code == 200
        assert client.post(f"{API}/session", json={"token": known["viewer"]}, headers=behind).status_code == 200
        assert client.get(f"{API}/session", headers=behind).json()["role"] == "viewer"


def test_nobody_says_for_whom_they_ask_but_the_proxy(tokens, tmp_path):
    path, _ = tokens
    with served(Settings(tmp_path, access=path)) as client:
        for i in range(TRIES):
            refused(client.get(f"{API}/runs", headers=bearer("wrong") | {"X-Forwarded-For": f"192.0.2.{i}"}), 401)
        detail = refused(client.get(f"{API}/runs", headers=bearer("wrong") | {"X-Forwarded-For": "192.0.2.99"}), 429)
        assert "from 127.0.0.1" in detail


# Where from


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "10.0.0.1", "localhost.evil:80"])
def test_a_name_that_somebody_points_at_this_address_gets_nothing(opened, host):
    for path in ("/", f"{API}/session", "/static/app.js"):
        assert "not a name of this server" in refused(opened.get(path, headers={"Host": host}), 403)


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:8321", "127.0.0.1", "[::1]:9000"])
def test_this_machine_is_asked_for_by_any_of_its_names(opened, host):
    assert opened.get(f"{API}/session", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "https://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://127.0.0.1:1"}, 403),  # another server on this machine
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Sec-Fetch-Site": "same-site"}, 403),
        ({"Content-Type": "text/plain"}, 415),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415),
        ({"Content-Type": "multipart/form-data; boundary=x"}, 415),
        ({"Content-Type": ""}, 415),
    ],
)
def test_a_page_of_another_site_changes_nothing(opened, headers, status):
    for path in ("/live/SIM-0001/run/abort", "/starts", "/session"):
        refused(opened.post(API + path, content=b"{}", headers=JSON | headers), status)


def test_an_import_needs_a_header_that_no_form_can_send(opened):
    detail = refused(opened.post(f"{API}/imports", files={"file": ("a.csv", b"1")}), 403)
    assert "X-Bench: 1" in detail


def test_a_page_of_this_server_may(opened):
    own = str(opened.base_url).rstrip("/")
    answer = opened.post(f"{API}/session", json={"token": "any"}, headers={"Origin": own})
    assert answer.status_code == 200


def test_data_are_not_shown_to_pages_of_other_sites(opened):
    refused(opened.get(f"{API}/runs", headers={"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}), 403)


# What


def test_bodies_are_bounded_announced_or_not(opened):
    def endless():
        for _ in range(100):
            yield b'{"token": "' + b"x" * 1000

    body = b'{"token": "' + b"x" * 5000 + b'"}'
    assert "4096 bytes" in refused(opened.post(f"{API}/session", content=body, headers=JSON), 413)
    assert "4096 bytes" in refused(opened.post(f"{API}/session", content=endless(), headers=JSON), 413)


def raw(client, target):
    """Status and body of a GET of exactly this target; clients tidy up dots."""
    with socket.create_connection((client.base_url.host, client.base_url.port)) as connection:
        request = f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"
        connection.sendall(request.encode("latin-1"))
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), body


CLIMBING = ("../app.py", "%2e%2e/app.py", "..%2fapp.py", "%2e%2e%2fapp.py", "..%5capp.py", "%252e%252e/app.py",
            "....//app.py", "//etc/passwd", "%2fetc%2fpasswd", "x/../../app.py", "..%00/app.py")  # fmt: skip


@pytest.mark.parametrize("climb", CLIMBING)
@pytest.mark.parametrize("root", ["/static/", f"{API}/runs/", f"{API}/runs/u/", f"{API}/live/", f"{API}/units/"])
def test_no_path_leads_to_a_file_outside(opened, root, climb):
    for target in (root + climb, f"{root}{climb}/report", f"{root}{climb}/data.csv"):
        status, body = raw(opened, target)
        assert status in {400, 404, 405}, target
        assert b"create_app" not in body
        assert b"root:" not in body


def test_large_answers_are_packed_for_whoever_takes_them_so_and_events_are_not(opened):
    packed, plain = (opened.get(f"{API}/effects", headers={"Accept-Encoding": kind}) for kind in ("gzip", "identity"))
    assert (packed.headers["content-encoding"], packed.headers["vary"]) == ("gzip", "Accept-Encoding")
    assert "content-encoding" not in plain.headers
    assert packed.json() == plain.json()
    assert packed.num_bytes_downloaded < 0.5 * plain.num_bytes_downloaded
    small = opened.get(f"{API}/session", headers={"Accept-Encoding": "gzip"})
    stream = opened.get(f"{API}/live/stream", params={"events": 1}, headers={"Accept-Encoding": "gzip"})
    assert stream.headers["content-type"].startswith("text/event-stream")
    assert not {"content-encoding"} & ({*small.headers} | {*stream.headers})


@pytest.mark.parametrize("path", [*PAGES, f"{API}/session", f"{API}/nothing", "/nothing", "/static/nothing"])
def test_every_answer_carries_the_policy(opened, path):
    headers = opened.get(path).headers
    for name, value in policy.HEADERS.items():
        assert headers[name] == value
    assert headers["cache-control"] == ("no-store" if path.startswith("/api") else "no-cache")
    assert "access-control-allow-origin" not in headers
    assert "server" not in headers or headers["server"] == "uvicorn"


def test_the_policy_allows_no_script_but_our_files():
    rules = dict(rule.split(" ", 1) for rule in policy.PAGE.split("; "))
    assert rules["script-src"] == "'self'"
    assert rules["default-src"] == rules["base-uri"] == rules["frame-ancestors"] == "'none'"
    assert "unsafe-inline" not in policy.PAGE
    assert "unsafe-eval" not in policy.PAGE
    assert "http:" not in policy.PAGE
    assert "allow-same-origin" not in policy.REPORT


@pytest.mark.parametrize("path", PAGES)
def test_every_address_of_the_page_is_the_page(opened, path):
    answer = opened.get(path)
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert "<script>" not in answer.text
    assert " style=" not in answer.text


def test_an_address_that_nothing_has_is_said_by_the_page_to_people_and_in_json_to_programs(opened):
    lost = opened.get("/nowhere/at/all")
    assert (lost.status_code, lost.text) == (404, opened.get("/").text)
    for path in ("/api/v1/nowhere", "/static/nowhere.js"):
        assert (opened.get(path).status_code, list(opened.get(path).json())) == (404, ["detail"])


# The command


def test_another_address_without_tokens_is_refused_and_says_what_to_do(tmp_path):
    answer = bench("ui", "--host", "0.0.0.0", "--out", tmp_path, "--no-browser")
    assert answer.exit_code == 2
    assert answer.stderr.count("\n") == 1
    assert "--new-token NAME" in answer.stderr


def test_a_new_token_is_printed_once_and_stored_as_a_hash_in_a_file_of_its_owner(tmp_path):
    path = tmp_path / "access.yaml"
    token = bench("ui", "--access", path, "--new-token", "Олена", "--role", "operator").stdout.strip()
    bench("ui", "--access", path, "--new-token", "Li", "--role", "viewer")
    text = path.read_text()
    assert token not in text
    assert hashlib.sha256(token.encode()).hexdigest() in text
    assert [person.name for person in people.read(path).people] == ["Олена", "Li"]
    assert os.name != "posix" or path.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--access", "missing.yaml"], "no access file"),
        (["--new-token", "A"], "needs --access FILE"),
        (["--new-token", "<script>", "--access", "a.yaml", "--role", "viewer"], "must be up to 40 letters"),
        (["--certificate", "a.pem"], "belong together"),
        (["--certificate", "a.pem", "--key", "b.pem"], "no such file"),
        (["--host", "no.such.host.invalid", "--access", "good.yaml"], "--host no.such.host.invalid"),
        (["--access", "loose.yaml"], "chmod 600"),
        (["--access", "odd.yaml"], "odd.yaml:1: "),
        (["--out", "odd.yaml"], "cannot hold run folders"),
        (["--behind", "127.0.0.1"], "--new-token NAME"),
        (["--behind", "proxy.local", "--access", "good.yaml"], "must be the IP address"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    people.add_person(Path("good.yaml"), "A", "viewer")
    Path("odd.yaml").write_text("people: 5\n", encoding="utf-8")
    Path("loose.yaml").write_text("people: []\n", encoding="utf-8")
    for name, mode in (("odd.yaml", 0o600), ("loose.yaml", 0o666)):
        Path(name).chmod(mode)
    answer = bench("ui", "--no-browser", *arguments)
    assert answer.exit_code == 2, answer.output
    assert answer.stderr.count("\n") == 1
    assert words in answer.stderr


def test_a_taken_port_is_said_in_one_line(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        answer = bench("ui", "--no-browser", "--out", tmp_path, "--port", port)
    assert answer.exit_code == 2
    assert "`--port 0` takes a free one" in answer.stderr


def test_tls_is_checked_before_and_its_cookies_go_over_nothing_else(tokens, tmp_path):
    path, known = tokens
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost",
               "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(certificate)]  # fmt: skip
    try:
        subprocess.run(command, check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("openssl is not installed")
    Tls(certificate, key).check()
    with pytest.raises(InputError, match="not a certificate chain and its key"):
        Tls(key, certificate).check()
    with served(Settings(tmp_path / "out", access=path, secure=True), Tls(certificate, key)) as plain:
        trust = ssl.create_default_context(cafile=str(certificate))
        with httpx.Client(base_url=f"https://127.0.0.1:{plain.base_url.port}", verify=trust, trust_env=False) as client:
            cookie = client.post(f"{API}/session", json={"token": known["viewer"]}).headers["set-cookie"]
            assert cookie.startswith("__Host-bench-")
            assert "Secure" in cookie.split("; ")
            assert client.get(f"{API}/session").json()["role"] == "viewer"
