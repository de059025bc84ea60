"""The list of runs: an index that is built once, follows the disk by the folders' times, and never leaves the store."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.acquisition.run.remote import LiveFile
from bench.web.ground.problems import NotFoundError
from bench.web.ground.settings import Settings
from bench.web.live.story import verdicts
from bench.web.shelf import indexing
from bench.web.shelf.indexing import LOOK_S, SAVE_S, Index, ordered
from tests.support import run_folders
from tests.support.web_client import served


class Clock:
    """Bench time of a test."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def write(root: Path, run: str, *, held_out: float | None = None, **manifest: object) -> Path:
    folder = root / run
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "format": 1, "run": folder.name, "unit": run.partition("/")[0], "profile": "ramp", "state": "done",
        "created": "2026-11-21T06:00:00+00:00", "duration_s": 60.0, "files": {"data.parquet": "aa"}, **manifest,
    }  # fmt: skip
    (folder / "manifest.json").write_text(json.dumps(content), encoding="utf-8")
    if held_out is not None:
        models = [{"name": "spline", "rms_dph": 0.1, "held_out_rms_dph": held_out},
                  {"name": "line", "rms_dph": 2.0, "held_out_rms_dph": 3.0}]  # fmt: skip
        compared = {"verdict": "adequate", "floor_dph": 0.1, "models": models}
        (folder / "compare.json").write_text(json.dumps(compared), encoding="utf-8")
    return folder


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    folder = tmp_path / ".web"
    folder.mkdir()
    return folder


def test_a_run_says_which_steps_to_the_certificate_are_done(tmp_path: Path) -> None:
    origin, check = (write(tmp_path, f"SIM-0001/20261121T0{hour}0000Z_ramp") for hour in (6, 8))

    def steps(folder: Path) -> dict[str, bool]:
        with served(Settings(out=tmp_path)) as client:
            found: dict[str, bool] = client.get(f"/api/v1/runs/SIM-0001/{folder.name}").json()["steps"]
        return found

    assert not any(steps(origin).values())
    fit = {"model": {"name": "spline"}, "coefficients": [], "parameters": [], "validity": {}}
    run_folders.keep(origin, "calibration.json", {"verdict": {"verdict": "adequate"}, "calibration": fit})
    run_folders.keep(origin, "flash.json", {"state": "done"})
    verified = {"verdict": "PASS", "calibration_run": f"/elsewhere/{origin.name}"}
    run_folders.keep(check, "verification.json", verified)
    run_folders.keep(origin, "certificate.json", {"number": "1", "draft": ["no laboratory"]})
    wanted = {"calibrated": True, "flashed": True, "verified": True, "certified": False}
    assert steps(origin) == steps(check) == wanted


def test_a_verification_is_judged_by_its_own_record(tmp_path: Path) -> None:
    origin, check = (write(tmp_path, f"SIM-0001/20261121T0{hour}0000Z_ramp") for hour in (6, 8))
    found = {"verdict": "PASS", "rms_dph": 0.2692, "over_floor": 2.471, "calibration_run": f"/elsewhere/{origin.name}"}

    def told() -> tuple[dict[str, Any], dict[str, Any]]:
        with served(Settings(out=tmp_path)) as client:
            ended = client.get(f"/api/v1/live/SIM-0001/{check.name}").json()["ended"]
            return ended["units"][0], client.get(f"/api/v1/runs/SIM-0001/{check.name}").json()

    run_folders.keep(check, "verification.json", {**found, "rule": "RMS at most 3 times", "refusals": ["too short"]})
    unit, run = told()
    said = "0.2692 deg/h RMS of its own output, 2.47 x its noise floor"
    assert (unit["analysed"], unit["limits"], unit["sentence"]) == (True, "PASS", said)
    assert (run["sentence"], run["calibration"], run["report"]) == (said, False, False)
    assert run["verifies"] == f"SIM-0001/{origin.name}"
    rule = {"verdict": "PASS", "decision_rule": "RMS at most 3 times", "refusals": ["too short"]}
    assert run["limits"] == rule
    limits = {"name": "quick", "verdict": "FAIL", "refusals": [], "results": []}
    run_folders.keep(check, "verification.json", {**found, "verdict": "FAIL", "limits": limits})
    unit, run = told()
    assert (unit["limits"], run["limits"]) == ("FAIL", limits)


def test_a_run_is_of_the_unit_that_its_manifest_names(tmp_path: Path) -> None:
    """The name of a folder has no letters of other alphabets; a link to such a unit would lead nowhere."""
    folder = write(tmp_path, "GX---7/20261121T060000Z_ramp", unit="GX-Ж-7")
    with served(Settings(out=tmp_path)) as client:
        assert client.get(f"/api/v1/runs/GX---7/{folder.name}").json()["unit"] == "GX-Ж-7"
    assert verdicts([folder])["units"][0]["unit"] == "GX-Ж-7"


def test_ten_thousand_runs_are_read_once_and_then_answered_from_memory(
    tmp_path: Path, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for unit in range(100):
        for run in range(100):
            folder = tmp_path / f"U-{unit:03d}" / f"run-{run:03d}"
            (folder / "journal").mkdir(parents=True)
    read: list[str] = []
    original = indexing._read
    monkeypatch.setattr(indexing, "_read", lambda *a: read.append(a[0]) or original(*a))
    clock = Clock()
    assert len(Index(tmp_path, kept, clock).entries()) == 10_000 == len(read)
    index = Index(tmp_path, kept, clock)  # the server again
    assert len(index.matching("u-042", {})) == 100
    clock.now += LOOK_S
    assert len(index.matching("u-042 run-007", {"state": "unfinished"})) == 1
    assert len(read) == 10_000  # nothing was read a second time


def test_only_what_changed_is_read_again(tmp_path: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, "A/one")
    write(tmp_path, "A/two")
    clock = Clock()
    index = Index(tmp_path, kept, clock)
    assert index.entries()["A/one"].verdict == ""
    read: list[str] = []
    original = indexing._read
    monkeypatch.setattr(indexing, "_read", lambda *a: read.append(a[0]) or original(*a))
    write(tmp_path, "A/one", held_out=0.15)
    write(tmp_path, "B/three")
    assert len(index.entries()) == 2  # a look is good for a second
    clock.now += LOOK_S
    assert index.entries()["A/one"].held_out_rms_dph == 0.15
    assert sorted(read) == ["A/one", "B/three"]


def test_a_run_that_was_removed_is_gone_and_changes_are_kept(tmp_path: Path, kept: Path) -> None:
    folder = write(tmp_path, "A/one")
    clock = Clock()
    index = Index(tmp_path, kept, clock)
    index.entries()
    (folder / "manifest.json").unlink()
    folder.rmdir()
    clock.now += SAVE_S
    assert index.entries() == {}
    assert json.loads((kept / indexing.FILE).read_bytes())["runs"] == []


def test_the_best_model_on_unseen_data_speaks_for_a_run_and_limits_for_its_verdict(tmp_path: Path, kept: Path) -> None:
    folder = write(tmp_path, "A/one", held_out=0.15)
    (folder / "limits.json").write_text('{"verdict": "PASS"}', encoding="utf-8")
    entry = Index(tmp_path, kept).entry("A/one")
    assert (entry.verdict, entry.rms_dph, entry.held_out_rms_dph, entry.floor_dph) == ("PASS", 0.1, 0.15, 0.1)


def test_a_run_without_a_manifest_began_when_its_folder_says(tmp_path: Path, kept: Path) -> None:
    for name in ("20261127T011511Z_short", "trial"):
        (tmp_path / "A" / name / "journal").mkdir(parents=True)
    begun = {name: entry.start for name, entry in Index(tmp_path, kept, Clock()).entries().items()}
    assert begun == {"A/20261127T011511Z_short": "2026-11-27T01:15:11+00:00", "A/trial": ""}


def test_a_live_run_is_running_and_a_killed_one_unfinished(tmp_path: Path, kept: Path) -> None:
    children = [subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) for _ in range(2)]
    for name, child in zip(("live", "killed"), children, strict=True):
        folder = tmp_path / "A" / name
        (folder / "journal").mkdir(parents=True)
        LiveFile(child.pid, 9, "2026", [], "t").write(folder)
    (tmp_path / "A" / "notes").mkdir()
    clock = Clock()
    index = Index(tmp_path, kept, clock)

    def states() -> dict[str, str]:
        clock.now += LOOK_S
        return {name: entry.state for name, entry in index.entries().items()}

    try:
        assert states() == {"A/live": "running", "A/killed": "running"}
        children[1].kill()
        children[1].communicate()
        assert states() == {"A/live": "running", "A/killed": "unfinished"}
    finally:
        children[0].communicate()


def test_spoilt_files_and_links_do_no_harm(tmp_path: Path, kept: Path) -> None:
    outside = write(tmp_path / "elsewhere", "X/secret")
    root = tmp_path / "store"
    write(root, "A/one")
    (root / "A" / "one" / "compare.json").write_text("{", encoding="utf-8")
    (root / "A" / "linked").symlink_to(outside, target_is_directory=True)
    (root / "B").symlink_to(outside.parent, target_is_directory=True)
    (kept / indexing.FILE).write_text("[]", encoding="utf-8")
    assert list(Index(root, kept).entries()) == ["A/one"]


@pytest.mark.parametrize("run", ["../elsewhere/x", "A/..", "A/../../x", "/etc/passwd", "A/one/journal", "A/%2e%2e"])
def test_no_path_is_made_of_what_was_asked(tmp_path: Path, kept: Path, run: str) -> None:
    write(tmp_path, "A/one")
    with pytest.raises(NotFoundError, match="no run"):
        Index(tmp_path, kept).entry(run)


def test_sorting_puts_runs_without_a_number_last(tmp_path: Path, kept: Path) -> None:
    for name, value in (("a", 0.3), ("b", None), ("c", 0.2)):
        write(tmp_path, f"U/{name}", held_out=value)
    entries = list(Index(tmp_path, kept).entries().values())
    up, down = ([e.run[-1] for e in ordered(entries, sort)] for sort in ("held_out_rms_dph", "-held_out_rms_dph"))
    assert (up, down) == (["c", "a", "b"], ["a", "c", "b"])


def test_the_api_lists_filters_and_shows_runs(tmp_path: Path) -> None:
    run_folders.make_run(tmp_path / "SIM-0001" / "20261121T060000Z_ramp", **run_folders.ramp_run(rate_hz=1.0))
    write(tmp_path, "OTHER/20261120T060000Z_quick", profile="quick")
    with served(Settings(out=tmp_path)) as client:
        everything = client.get("/api/v1/runs").json()
        assert (everything["total"], everything["profiles"]) == (2, ["quick", "ramp_-40_85"])
        found = client.get("/api/v1/runs", params={"q": "sim ramp", "limit": 1}).json()
        assert (found["matched"], found["runs"][0]["unit"]) == (1, "SIM-0001")
        assert not {"content", "changed"} & found["runs"][0].keys(), "the index's own"
        shown = client.get("/api/v1/runs/SIM-0001/20261121T060000Z_ramp").json()
        assert (len(shown["segments"]), shown["losses"]["lost"], shown["report"]) == (7, 0, False)
        assert {"name": "data.parquet", "bytes": (tmp_path / shown["run"] / "data.parquet").stat().st_size} in shown[
            "files"
        ]
        assert client.get("/api/v1/runs/SIM-0001/nothing").status_code == 404
        assert client.get("/api/v1/runs", params={"sort": "password"}).status_code == 422
        missing = client.get("/api/v1/runs/SIM-0001/20261121T060000Z_ramp/report")
        assert (missing.status_code, missing.json()["detail"]) == (
            404,
            "this run has no report: make one with `bench report`",
        )


def test_a_folder_of_somebody_else_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    odd = write(tmp_path, "Блок/one", segments=3, losses=[1])
    (odd / "calibration.json").write_text('{"verdict": "fine"}', encoding="utf-8")
    (odd / "events.jsonl").write_text('{"kind": "end", "text": "over"}\n{"kind": "sa', encoding="utf-8")
    pq.write_table(pa.table({"time": [0.5]}), odd / "means.parquet")
    with served(Settings(out=tmp_path)) as client:
        shown = client.get("/api/v1/runs/Блок/one").json()
        assert (shown["state"], shown["segments"], shown["losses"], len(shown["events"])) == ("damaged", [], {}, 1)
        assert [warning.partition(": ")[2].partition(" is ")[0] for warning in shown["warnings"]] == [
            "segments",
            "verdict",
        ]
        assert client.get("/api/v1/live/Блок/one").json()["ended"]["cause"] == "over"
        data = client.get("/api/v1/runs/Блок/one/data.csv")
        assert (data.text, data.headers["content-disposition"]) == (
            "time\n0.5\n", "attachment; filename*=UTF-8''%D0%91%D0%BB%D0%BE%D0%BA-one.csv",
        )  # fmt: skip


def test_a_report_cannot_reach_the_page_and_data_come_as_csv(tmp_path: Path) -> None:
    run = run_folders.make_run(tmp_path / "SIM-0001" / "one", **run_folders.ramp_run(rate_hz=1.0))
    (run / "report.html").write_text("<script>1</script>", encoding="utf-8")
    (run / "certificate.pdf").symlink_to("/etc/hostname")
    with served(Settings(out=tmp_path)) as client:
        report = client.get("/api/v1/runs/SIM-0001/one/report")
        assert report.headers["content-security-policy"].startswith("sandbox allow-scripts")
        assert "allow-same-origin" not in report.headers["content-security-policy"]
        lines = client.get("/api/v1/runs/SIM-0001/one/data.csv").text.splitlines()
        assert lines[0].startswith("time,rate,rate_count,rate_var,temperature")
        assert lines[1].startswith("0.5,")
        assert client.get("/api/v1/runs/SIM-0001/one/certificate").status_code == 404  # it leads out of the store
