"""What commands do with an ended run and a station from the page: report, export, replay, certificate, doctor …"""

import json
import shutil
from pathlib import Path

import pytest

from bench.base import library
from bench.deliver import IMU_FORMATS, MEASURED
from bench.record import CertificateRecord, ImuSource, sha256
from bench.web.ground.settings import Settings
from bench.web.shelf.steps import whole_of
from tests.deliver.test_imu_certificate import verification
from tests.support.imu_units import imu_record
from tests.support.notices import webhook
from tests.support.report_runs import quick
from tests.support.run_folders import make_run, ramp_run
from tests.support.waiting import until
from tests.support.web_client import served


@pytest.fixture(scope="module")
def bench(short_run, tmp_path_factory):
    """A client of a server, the address of a run that was analysed and its folder; beside it one with raw frames."""
    root = tmp_path_factory.mktemp("actions")
    folder = make_run(root / "out" / "SIM-0001" / "20261121T060000Z_ramp", **ramp_run())
    quick(folder, "spline_lag_loop")
    shutil.copytree(short_run.path, folder.parent / short_run.path.name)
    with served(Settings(root / "out", project=root)) as client:
        yield client, f"/api/v1/runs/SIM-0001/{folder.name}", folder


def done(client, path, **body):
    """The result of a job, or the reason why it failed."""
    answer = client.post(path, json=body)
    assert answer.status_code == 202, answer.text
    job = until(lambda: (seen := client.get(f"/api/v1/jobs/{answer.json()['job']}?wait_s=20").json())["state"]
                in {"done", "failed"} and seen)  # fmt: skip
    return job["result"] if job["state"] == "done" else job["detail"]


def test_a_run_that_was_not_analysed_is_analysed_once(bench):
    client, _, folder = bench
    bare = make_run(folder.parent / "20261122T060000Z_ramp", **ramp_run())
    run = f"/api/v1/runs/SIM-0001/{bare.name}"
    assert client.post(f"{run}/report", json={"models": ["nobody"]}).status_code == 400
    made = done(client, f"{run}/report", models=["spline"])
    assert made["run"] == f"SIM-0001/{bare.name}"
    assert (bare / "report.html").is_file()
    assert client.get(run).json()["report"]
    assert client.post(f"{run}/report", json={}).status_code == 409


def test_a_run_is_exported_and_its_files_are_sent(bench):
    client, run, folder = bench
    assert {"json", "hex", "a2l"} <= set(client.get(f"{run}/exports").json()["formats"])
    (name,) = done(client, f"{run}/exports", format="csv")["files"]
    sent = client.get(f"{run}/exports/{name}")
    assert sent.content == (folder / "export" / name).read_bytes()
    assert client.get(f"{run}/exports").json()["files"] == [name]
    assert "allowed are json" in done(client, f"{run}/exports", format="pdf")
    assert client.get(f"{run}/exports/..%2fmanifest.json").status_code == 404


def test_a_run_is_replayed_and_what_was_altered_is_named(bench, short_run):
    client, _, analysed = bench
    folder = analysed.parent / short_run.path.name
    run = f"/api/v1/runs/SIM-0001/{folder.name}"
    same = done(client, f"{run}/replay")
    assert (same["identical"], same["from_frames"], same["run"]) == (True, True, run.removeprefix("/api/v1/runs/"))
    with (folder / "events.jsonl").open("ab") as file:
        file.write(b"\n")
    altered = done(client, f"{run}/replay")
    assert not altered["identical"]
    assert "events.jsonl" in json.dumps(altered["tampered"])
    assert str(folder) not in json.dumps(altered)


def test_a_certificate_is_refused_by_a_sentence_and_a_draft_is_printed(bench):
    client, run, folder = bench
    refused = done(client, f"{run}/certificate")
    lacks = "no laboratory and no signatory; fill in the page 'Laboratory and equipment'; a draft can be printed"
    assert lacks in refused, "no file and no option of a command"
    assert str(folder) not in refused
    draft = done(client, f"{run}/certificate", draft=True)
    assert (draft["draft"], draft["file"]) == (True, "draft.pdf")
    assert client.get(f"{run}/certificate").status_code == 404
    assert client.get(f"{run}/certificate?draft=true").content.startswith(b"%PDF-")


def test_the_certificate_that_a_whole_calibration_issued_is_that_of_its_run(bench):
    client, _, folder = bench
    run = make_run(folder.parent.parent / "GX-7" / folder.name, **ramp_run(), unit="GX-7")
    job = run.parent / "20261121T055900Z_calibrate_brief"
    job.mkdir()
    for place in (run, job):
        CertificateRecord(number="GX-7-20261121-AB").write(place)
    page = f"/api/v1/runs/GX-7/{run.name}"
    assert not client.get(page).json()["certificate"], "it was not printed"
    (job / "certificate.pdf").write_bytes(b"%PDF-1.7")
    assert client.get(page).json()["certificate"]
    assert client.get(f"{page}/certificate").content == b"%PDF-1.7"


def stood(**truth):
    """A run in whose segments the unit stands in a known attitude."""
    run = ramp_run(**truth)
    return {**run, "segments": [{**segment, "attitude": "z_up"} for segment in run["segments"]]}


def test_other_folders_are_not_looked_through_for_a_run_without_attitudes(tmp_path, monkeypatch):
    folder = make_run(tmp_path / "out" / "G-1" / "one", **ramp_run())
    monkeypatch.setattr(Path, "glob", lambda *_: pytest.fail("looked through all folders"))
    assert whole_of(folder) == folder


def test_a_whole_inertial_unit_is_exported_and_certified_by_its_run(tmp_path):
    folder = make_run(tmp_path / "out" / "SIM-IMU-0042" / "20261121T060000Z_imu_quick", **stood())
    whole = tmp_path / "block 7"
    whole.mkdir()
    source = ImuSource(file=f"{folder.name}/means.parquet", sha256=sha256(folder / "means.parquet"))
    imu_record().model_copy(update={"sources": (source,)}).write(whole)
    other = make_run(tmp_path / "out" / "X" / folder.name, **stood(loop_dph=0.0))
    assert (whole_of(folder), whole_of(other)) == (whole, other)
    verification().write(whole)
    for kind, name in (("laboratory", "simulated"), ("equipment", "simulated_rate_table")):
        shutil.copy(library() / kind / f"{name}.yaml", whole / f"{kind}.yaml")
    with served(Settings(tmp_path / "out", project=tmp_path)) as client:
        run = f"/api/v1/runs/SIM-IMU-0042/{folder.name}"
        formats = client.get(f"{run}/exports").json()["formats"]
        assert sorted(formats) == sorted({*IMU_FORMATS, *MEASURED})
        (noise,) = done(client, f"{run}/exports", format="kalibr")["files"]
        assert "accelerometer_noise_density" in (whole / "export" / noise).read_text()
        files = done(client, f"{run}/exports", format="json")["files"]
        assert client.get(f"{run}/exports").json()["files"] == sorted([*files, noise])
        assert client.get(f"{run}/exports/{files[0]}").content == (whole / "export" / files[0]).read_bytes()
        assert not (folder / "export").exists()
        issued = done(client, f"{run}/certificate")
        assert (issued["verdict"], issued["draft"]) == ("PASS", False)
        told = client.get(run).json()
        assert (told["certificate"], told["steps"]) == (
            True, {"calibrated": True, "flashed": False, "verified": True, "certified": True},
        )  # fmt: skip
        assert client.get(f"{run}/certificate").content.startswith(b"%PDF-")


def test_doctor_tells_what_the_station_says(bench):
    client, _, _ = bench
    found = done(client, "/api/v1/stations/simulated/doctor")
    assert (found["station"], found["agrees"]) == ("simulated", True)
    assert {one["verdict"] for one in found["findings"]} <= {"agrees", "unknown", "told"}
    assert client.post("/api/v1/stations/nowhere/doctor", json={}).status_code == 400


def test_a_trial_goes_to_everybody_whom_the_station_tells(bench):
    client, _, folder = bench
    stations = folder.parents[2] / "profiles" / "stations"
    stations.mkdir(parents=True, exist_ok=True)
    shipped = (library() / "stations" / "simulated.yaml").read_text()
    (stations / "telling.yaml").write_text(f"{shipped}\nnotify: notify.yaml\n")
    with webhook() as hook:
        to = f"recipients:\n  - {{name: chat, url: 'json://127.0.0.1:{hook.port}'}}\n  - {{name: gone, url: 'json://127.0.0.1:1'}}\n"
        (stations / "notify.yaml").write_text(to)
        found = done(client, "/api/v1/stations/telling/notices")["recipients"]
        assert hook.next()
    assert (found["chat"], bool(found["gone"]), ":1" in found["gone"]) == ("", True, False)


@pytest.mark.slow
def test_the_calibration_is_written_into_its_unit_by_whoever_asked(bench):
    client, run, folder = bench
    unit = folder.parent.name
    asked = client.post(f"{run}/flash", json={"station": "simulated", "operator": "Olena"})
    assert asked.status_code == 202, asked.text
    start = until(lambda: (now := client.get(f"/api/v1/starts/{asked.json()['start']}").json())["state"] in
                  {"ended", "refused"} and now)  # fmt: skip
    assert start["exit_code"] == 0, start
    (record,) = (json.loads(path.read_text()) for path in (folder.parent / "flash").glob("*.json"))
    assert (record["state"], record["unit"]) == ("done", unit)
    assert record["operator"].startswith("Olena (engineer) from ")
    elsewhere = client.post(f"{run}/flash", json={"station": "simulated", "slot": f"GX-9@{unit}"})
    assert (elsewhere.status_code, "slot is" in elsewhere.text) == (400, True), elsewhere.text
