"""The page is served while the API is imported: its requests wait, and a failed import ends the command."""

import re
import threading
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from types import ModuleType

from click.testing import CliRunner

from bench.cli import main
from bench.web.ground.settings import Settings
from bench.web.server import app
from tests.support.web_client import served


def test_page_and_files_are_served_while_the_api_is_imported_and_its_requests_wait(tmp_path, monkeypatch):
    go_on = threading.Event()

    def late(name: str) -> ModuleType:
        assert go_on.wait(30)
        return import_module(name)

    monkeypatch.setattr(app, "import_module", late)
    with served(Settings(tmp_path)) as client, ThreadPoolExecutor() as threads:
        waiting = [threads.submit(client.get, f"/api/v1/{path}") for path in ("session", "runs", "live")]
        try:
            page = client.get("/")
            files = re.findall('(?:src|href)="(/static/[^"]+)"', page.text)
            assert [client.get(path).status_code for path in ("/", *files)] == [200] * (1 + len(files))
            assert not any(answer.done() for answer in waiting)
        finally:
            go_on.set()
        assert [answer.result(30).status_code for answer in waiting] == [200, 200, 200]


def test_an_import_that_fails_ends_the_command_in_one_line_with_exit_code_2(tmp_path, monkeypatch):
    def missing(_: str) -> ModuleType:
        raise ModuleNotFoundError("No module named 'cachetools'", name="cachetools")

    monkeypatch.setattr(app, "import_module", missing)
    answer = CliRunner().invoke(main, ["ui", "--no-browser", "--port", "0", "--out", str(tmp_path)])
    assert answer.exit_code == 2
    address, said = answer.stderr.splitlines()
    assert address.startswith("bench ui: http://127.0.0.1:")
    assert "`bench ui` needs cachetools; pip install 'gyro-thermal-bench[web]'" in said


def test_what_asks_the_api_while_its_import_fails_hears_that_the_server_cannot_begin(tmp_path, monkeypatch):
    go_on = threading.Event()

    def failing(_: str) -> ModuleType:
        assert go_on.wait(30)
        raise ImportError("no such API")

    monkeypatch.setattr(app, "import_module", failing)
    with served(Settings(tmp_path)) as client, ThreadPoolExecutor() as threads:
        waiting = threads.submit(client.get, "/api/v1/session")
        go_on.set()
        answer = waiting.result(30)
    assert (answer.status_code, answer.json()) == (503, {"detail": "the server cannot begin; its terminal says why"})
