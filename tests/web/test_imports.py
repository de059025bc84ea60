"""Imports through the page: a table is shown as it was understood, then imported; hostile files do no harm."""

import io
import json
import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.base.errors import InputError
from bench.record import faults
from bench.record.folder import RunFolder
from bench.web.ground.settings import Settings
from bench.web.imports import imports
from bench.web.imports.confined import Confines, previewed
from bench.web.imports.uploads import safe_name
from tests.support.waiting import until
from tests.support.web_client import served

API = "/api/v1/imports"
HEADERS = {"X-Bench": "1"}
FIRST = {"name": "spline", "effects": [{"effect": "spline", "intervals": 24, "ends": "natural"}]}


def table(rows=600, header="time [s],gx,T (degC)"):
    lines = (f"{i},{0.001 + 1e-5 * (i % 7)},{25 + i / 20}" for i in range(rows))
    return "\n".join([header, *lines, ""]).encode()


@pytest.fixture
def client(tmp_path):
    settings = Settings(out=tmp_path / "out", project=tmp_path, upload_bytes=2_000_000)
    with served(settings) as client:
        yield client


def send(client, content, name="log.csv", **more):
    return client.post(API, files={"file": (name, content)}, headers=HEADERS, **more)


def ended(client, answer):
    assert answer.status_code == 202, answer.text
    job = answer.json()["job"]
    while (told := client.get(f"/api/v1/jobs/{job}?wait_s=20").json())["state"] in {"waiting", "running"}:
        pass
    return told


def test_an_upload_leaves_the_disk_to_the_runs(client, tmp_path, monkeypatch):
    monkeypatch.setattr("bench.web.imports.uploads.SPARE_BYTES", 1 << 62)
    refused = send(client, table())
    assert (refused.status_code, "the disk is nearly full" in refused.json()["detail"]) == (400, True)
    assert list((tmp_path / "out" / ".web" / "imports").iterdir()) == []


@pytest.mark.slow
def test_the_fields_of_all_that_is_unclear_are_shown_at_once(client):
    text = "t [s],gx,gy,gz,T (degC)\n" + "".join(f"{n},1,2,3,{20 + n}\n" for n in range(20))
    shown = ended(client, send(client, text.encode()))["result"]
    said = "'gx', 'gy', 'gz' do not say their units, which may be deg/h, deg/s, mdps, rad/s; choose them below"
    assert shown["problem"] == said
    rates = {"rate_x": "gx", "rate_y": "gy", "rate_z": "gz"}
    assert shown["guess"] == {"time": "t [s]", "temperature": "T (degC)", **rates}


@pytest.mark.slow
def test_a_table_whose_unit_is_unclear_is_shown_then_mapped_then_imported(client, tmp_path):
    sent = send(client, table())
    shown = ended(client, sent)["result"]
    assert "does not say its unit" in shown["problem"]
    assert [one["name"] for one in shown["columns"]] == ["time [s]", "gx", "T (degC)"]
    assert shown["columns"][0]["first"] == [0, 1, 2, 3, 4]
    assert shown["guess"] == {"time": "time [s]", "rate": "gx", "temperature": "T (degC)"}

    place = f"{API}/{sent.json()['import']}"
    wanted = {"unit": "GX-7", "columns": {"rate": {"column": "gx", "unit": "deg/s"}}}
    shown = ended(client, client.post(f"{place}/preview", json=wanted))["result"]
    assert shown["problem"] is None
    rate = next(one for one in shown["understood"]["channels"] if one["channel"] == "rate")
    assert rate["low"] == pytest.approx(3.6)
    assert shown["figure"]["data"]

    made = ended(client, client.post(place, json=wanted))["result"]
    folder = RunFolder(tmp_path / "out" / made["run"])
    assert folder.path.parent.name == "GX-7"
    assert folder.manifest().operator
    assert folder.manifest().source["file"] == "log.csv"
    assert [*faults(folder.path), *faults(tmp_path / "out")] == [], "this bench signed it, with its own key"
    assert client.get("/api/v1/units/GX-7").json()["runs"][0]["kind"] == "import"
    drawn = ended(client, client.post("/api/v1/figures", json={"kind": "time", "runs": [made["run"]], "model": FIRST}))
    assert drawn["result"]["figure"]["data"], "the workbench draws it, whether its first model fits or not"
    assert client.post(place, json=wanted).status_code == 404, "what was imported is gone"


@pytest.mark.slow
def test_an_upload_that_is_given_up_is_gone(client, tmp_path):
    sent = send(client, table())
    ended(client, sent)
    place = f"{API}/{sent.json()['import']}"
    assert client.delete(place).status_code == 200
    assert client.post(f"{place}/preview", json={}).status_code == 404
    assert not list((tmp_path / "out" / ".web" / "imports").iterdir())


def test_an_upload_without_the_header_or_by_another_site_is_refused(client):
    assert client.post(API, files={"file": ("a.csv", b"x")}).status_code == 403
    answer = client.post(API, files={"file": ("a.csv", b"x")}, headers={**HEADERS, "Origin": "http://evil.example"})
    assert answer.status_code == 403


def test_an_upload_is_bounded_while_it_comes_in(client, tmp_path):
    def of_unknown_length():
        yield b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n'
        for _ in range(60):
            yield b"1,2,3\n" * 10_000

    answer = client.post(
        API, content=of_unknown_length(), headers={**HEADERS, "Content-Type": "multipart/form-data; boundary=b"}
    )
    assert answer.status_code == 413
    assert not list((tmp_path / "out" / ".web" / "imports").iterdir()), "nothing is left of it"


def test_abandoned_uploads_are_listed_given_up_and_expire(client, tmp_path):
    folder = tmp_path / "out" / ".web" / "imports"
    for number in range(imports.MOST):
        (folder / f"{number:016x}" / "file").mkdir(parents=True)
        (folder / f"{number:016x}" / "file" / f"{number}.csv").write_text("time,rate\n")
    full = send(client, "time,rate\n0,1\n")
    assert (full.status_code, "discard one" in full.json()["detail"]) == (503, True)
    waiting = client.get(API).json()["waiting"]
    assert sorted(one["file"] for one in waiting) == [f"{number}.csv" for number in range(imports.MOST)]
    assert client.delete(f"{API}/{waiting[0]['import']}", headers=HEADERS).status_code == 200
    old = folder / waiting[1]["import"]
    os.utime(old, (0, 0))
    assert len(client.get(API).json()["waiting"]) == imports.MOST - 2
    assert not old.exists()


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("../../etc/passwd.csv", "passwd.csv"),
        ("..\\..\\boot.ini.csv", "boot.ini.csv"),
        ("a\0b.csv", "a-b.csv"),
        ("=cmd|' /C calc'!A0.csv", "C calc--A0.csv"),
        ("вимірювання 3.csv", "вимірювання 3.csv"),
        ("….csv", "unnamed"),
        ("", "unnamed"),
    ],
)
def test_a_name_is_a_name_and_never_a_path(given, kept):
    assert safe_name(given) == kept
    assert len(safe_name(given * 200 + ".csv").encode()) <= 120


@pytest.mark.slow
def test_a_name_that_climbs_stays_in_its_folder(client, tmp_path):
    sent = send(client, table(), name="../../../../escaped.csv")
    assert sent.json()["file"] == "escaped.csv"
    assert ended(client, sent)["state"] == "done"
    found = [path.relative_to(tmp_path) for path in tmp_path.rglob("escaped.csv")]
    assert [str(path.parent.parent.parent) for path in found] == ["out/.web/imports"]


def test_a_file_of_another_kind_or_another_form_is_refused(client):
    assert "not of a kind" in send(client, b"MZ", name="tool.exe").json()["detail"]
    assert client.post(API, files={"other": ("a.csv", b"x")}, headers=HEADERS).status_code == 400
    assert (
        client.post(API, content=b"junk", headers={**HEADERS, "Content-Type": "multipart/form-data"}).status_code == 400
    )


@pytest.mark.slow
def test_a_unit_is_no_path_and_no_formula(client):
    sent = send(client, table())
    ended(client, sent)
    for unit in ("../GX", "=1+1", "a/b", "a\0b", ".web", "-rf"):
        answer = client.post(f"{API}/{sent.json()['import']}", json={"unit": unit})
        assert answer.status_code == 400, unit


def test_a_column_like_a_formula_is_shown_as_text_and_never_leaves_as_one(client):
    formula = "=cmd|'/c calc'!A0"
    sent = send(client, table(header=f"time [s],rate [deg/s],T (degC),{formula}").replace(b"\n1,", b"\n1,").replace(
        b"25.0\n", b"25.0,1\n"))  # fmt: skip
    told = ended(client, sent)
    assert told["state"] == "failed" or told["result"]["columns"][3]["name"] == formula


def refused(tmp_path, name, content, **limits):
    (tmp_path / "file").mkdir()
    (tmp_path / "file" / name).write_bytes(content)
    with pytest.raises(InputError) as error:
        previewed({"file": name, "serial": "X", "columns": {}}, tmp_path, Confines(**limits))
    return str(error.value)


def parquet(rows, row_groups=1):
    written = io.BytesIO()
    content = pa.table({name: pa.array(np.zeros(rows)) for name in ("time", "rate", "temperature")})
    with pq.ParquetWriter(written, content.schema) as writer:
        for _ in range(row_groups):
            writer.write_table(content)
    return written.getvalue()


def test_a_parquet_bomb_is_refused_by_what_it_says_of_itself(tmp_path):
    bomb = parquet(2_000_000, 20)
    assert len(bomb) < 1_000_000
    assert "unpacked" in refused(tmp_path, "bomb.parquet", bomb, memory_bytes=2 << 30)


def test_a_table_that_needs_more_memory_than_it_may_is_refused_in_words(tmp_path):
    text = b"time,rate,temperature\n" + b"1,2,3\n" * 4_000_000
    assert "memory" in refused(tmp_path, "large.csv", text, memory_bytes=450 << 20)


def test_a_file_that_keeps_the_processor_busy_is_stopped(tmp_path):
    text = b"time,rate,temperature\n" + b"#\n1,2,x\n" * 2_000_000
    assert "processor time" in refused(tmp_path, "slow.csv", text, cpu_s=1)


def test_a_reader_that_does_not_come_back_is_stopped(tmp_path):
    text = b"time,rate,temperature\n" + b"#\n1,2,x\n" * 2_000_000
    assert "longer than" in refused(tmp_path, "slow.csv", text, wall_s=0.5)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("header.csv", b"a" * 20_000_000, "header"),
        ("commas.csv", b"," * 20_000_000 + b"\n1,2\n", "header"),
        ("nul.csv", b"time,rate,te\0mp\n1,2,3\n2,3,4\n", "byte 0"),
        ("cell.csv", b"time,rate,temp\n1,2\0,3\n2,3,4\n", "byte 0"),
        ("trash.parquet", b"PAR1" + b"\xff" * 999 + b"PAR1", "Parquet"),
        ("trash.csv", bytes(range(256)) * 40, ""),
        ("empty.csv", b"", "empty"),
        ("log.blf", b"LOGG" + b"\0" * 100, "--dbc"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(tmp_path, name, content, said):
    text = refused(tmp_path, name, content)
    assert said in text
    assert "\n" not in text
    assert str(tmp_path) not in text


def test_uploads_of_the_day_before_are_swept_at_the_start(tmp_path):
    old = tmp_path / ".web" / "imports" / "old"
    old.mkdir(parents=True)
    os.utime(old, (0, 0))
    with served(Settings(out=tmp_path)):
        until(lambda: not old.exists())


def test_the_kinds_name_every_channel_with_its_units(client):
    kinds = client.get(API).json()
    assert {one["name"] for one in kinds["channels"] if one["required"]} == {"time", "rate", "temperature"}
    assert kinds["most_bytes"] == 2_000_000
    assert json.dumps(kinds).isascii()
