"""One bad file is one bad row of a list, with its reason; the others are answered."""

import gc
import os
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from bench.analysis.effects import formula
from bench.base import InputError
from bench.web.ground.settings import Settings
from tests.support.web_client import served

API = "/api/v1"
FOLDERS = {"plans": "", "stations": "stations", "limits": "limits", "models": "models"}
BAD = {
    "digits": b"name: a\nsegments: [{kind: soak, duration_min: " + b"1" * 4301 + b"}]\n",
    "hexadecimal": b"name: 0x" + b"f" * 100_000,
    "surrogate": b'name: "\\ud800"\ndescription: "\\udfff"\n',
    "deep": b"name: " + b"[" * 5000,
    "binary": bytes(range(256)),
    "empty": b"",
    "list": b"- 1\n",
    "long": b"name: a\nsegments: [{kind: soak, duration_min: 1.0e+308}]\n",
    "bomb": b"a: &a [x, x, x, x, x, x, x, x, x]\n"
    + b"".join(b"%c: &%c [%s]\n" % (98 + i, 98 + i, b", ".join([b"*%c" % (97 + i)] * 9)) for i in range(8)),
    "no date": b"name: 2026-13-45\nlimits: {}\n",
    "key": b"? [a, b]\n: 1\n",
    "tag": b"!!python/object/apply:os.system [ls]\n",
}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    project = tmp_path_factory.mktemp("project")
    for folder in FOLDERS.values():
        home = project / "profiles" / folder
        home.mkdir(parents=True, exist_ok=True)
        for name, content in BAD.items():
            (home / f"bad {name}.yaml").write_bytes(content)
        (home / "bad link.yaml").symlink_to(home / "nowhere")
        (home / "bad folder.yaml").mkdir()
        (home / "good.yaml").symlink_to(home / "good.yaml")  # a link to itself
        if os.name == "posix":
            (home / os.fsdecode(b"bad \xff name.yaml")).write_bytes(b"name: a\n")
    with served(Settings(out=project / "out", project=project)) as found:
        yield found


@pytest.mark.parametrize("what", FOLDERS)
def test_a_bad_file_is_a_bad_row_and_the_others_are_answered(client, what):
    answer = client.get(f"{API}/{what}")
    assert answer.status_code == 200, answer.text
    rows = {row.get("id", row.get("name")): row for row in answer.json()[what]}
    bad = {f"bad {name}" for name in BAD}
    assert bad <= set(rows)
    for name in bad - {"bad long"}:  # which may be a plan, only a useless one
        assert rows[name]["problem"], name
        assert "\n" not in rows[name]["problem"]
        assert len(rows[name]["problem"]) <= 400
    assert any(not row["problem"] for row in rows.values())


def gives_way(*_):
    """Called in the middle of parsing: another thread goes on then, which is otherwise rare."""
    time.sleep(0)


def test_formulas_are_parsed_in_many_threads(client):
    deep = "k*" + "(" * 60 + "temperature" + ")" * 60 + "".join(f"*sin(temperature+{i})" for i in range(10))

    def ask(number):
        try:
            return formula.parse(deep if number % 2 else f"k*temperature**{number}").amplitudes
        except InputError as error:
            return str(error)

    threshold = gc.get_threshold()
    gc.callbacks.append(gives_way)
    try:
        gc.set_threshold(3)
        with ThreadPoolExecutor(16) as pool:
            assert set(pool.map(ask, range(1000))) == {("k",)}
    finally:
        gc.set_threshold(*threshold)
        gc.callbacks.remove(gives_way)
    with ThreadPoolExecutor(16) as pool:
        wanted = {"expression": "k*exp(-time/tau)*quadrature", "bounds": {"tau": [60, 7200]}}
        answers = list(pool.map(lambda _: client.post(f"{API}/effects/formula", json=wanted), range(100)))
    assert {answer.status_code for answer in answers} == {200}
    assert all(answer.json()["ok"] for answer in answers)
