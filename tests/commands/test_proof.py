"""What commands say of an archive that was damaged, altered or registered by a wrong clock."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime, timedelta

import pytest

from bench.archive.registry.ledger import archive
from bench.base.errors import InputError
from bench.commands.flash_source import newest_run
from bench.commands.flash_unit import objection
from bench.commands.registering import register
from bench.deliver.export.image import read
from bench.deliver.export.words import to_words
from bench.record import Manifest
from tests.support.commands import bench
from tests.support.flash_bench import image
from tests.support.run_folders import keep, make_run

COLUMNS = {"time": [0.5, 1.5], "rate": [1.0, 2.0], "temperature": [20.0, 21.0]}
FIT = {"calibration": {"model": {"name": "spline"}}}


def calibrated(root, name, created):
    run = make_run(root / "SIM-0001" / name, COLUMNS, run=name, created=created)
    keep(run, "calibration.json", FIT)
    return run


@pytest.fixture
def root(tmp_path):
    """An archive of two registered runs; the first says that it was made in the future."""
    root = tmp_path / "reports"
    ahead = (datetime.now(UTC) + timedelta(days=2)).isoformat()
    for name, created in (("ahead", ahead), ("right", "2026-11-21T06:00:00+00:00")):
        register([calibrated(root, name, created)])
    return root


def test_the_newest_run_is_the_one_that_was_seen_last(root, capsys):
    assert newest_run(root, "SIM-0001").name == "right"
    assert "ahead says that it was made" in capsys.readouterr().err
    listed = bench("registry", "list", "--out", root, "--json")
    assert [run["path"] for run in json.loads(listed.stdout)["runs"]] == ["SIM-0001/right", "SIM-0001/ahead"]
    assert "a clock was or is wrong" in listed.stderr


def test_a_later_run_that_is_not_registered_has_to_be_named(root):
    calibrated(root, "later", "2099-01-01T00:00:00+00:00")
    with pytest.raises(InputError, match="run later is not registered"):
        newest_run(root, "SIM-0001")


def test_a_calibration_of_the_future_neither_goes_into_a_unit_nor_keeps_others_out():
    now, ahead = 1_700_000_000, 1_700_200_000
    future, present = (read(to_words(image(created=when))) for when in (ahead, now))
    assert "has not come yet" in str(objection(future, b"", now, older=False))
    assert objection(present, image(created=ahead), now, older=False) is None


def test_a_whole_archive_is_proven_and_each_fault_is_a_line(root):
    done = bench("verify-archive", "--out", root)
    assert (done.exit_code, "every file is what the bench wrote" in done.stdout) == (0, True)
    run = root / "SIM-0001" / "right"
    text = (run / "manifest.json").read_text()
    (run / "manifest.json").write_text(text.replace('"done"', '"lost"'))
    shutil.rmtree(root / "SIM-0001" / "ahead")
    done = bench("verify-archive", "--out", root, "--json")
    faults = json.loads(done.stdout)["faults"]
    assert done.exit_code == 1
    assert any("right/manifest.json: is not the file that was recorded" in fault for fault in faults)
    assert any("ahead/manifest.json: is missing" in fault for fault in faults)


def test_a_line_of_the_ledger_that_was_changed_or_cut_off_is_noticed(root):
    path = root / "ledger.jsonl"
    whole = path.read_text()
    for text in (whole.replace("SIM-0001/right", "SIM-0001/wrong"), whole[:-40], "", whole + "{}\n"):
        path.write_text(text)
        for command in ("registry list", "registry rebuild --check", "fleet", "registry operator Ada"):
            done = bench(*command.split(), "--out", root)
            assert (done.exit_code, "ledger.jsonl" in done.stderr) == (2, True), (command, done.output)
    path.write_text(whole)
    archive(root).append({"kind": "operator", "name": "Ada"})
    assert list(archive(root).broken()) == []


def test_a_torn_last_line_of_an_older_ledger_is_cut_off_and_not_appended_to(tmp_path):
    (tmp_path / "ledger.jsonl").write_text('{"kind": "archive", "id": "a"}\n{"kind": "operat')
    archive(tmp_path).append({"kind": "operator", "name": "Ada"})
    assert [entry["name"] for entry in archive(tmp_path).entries()] == ["Ada"]


def test_a_check_makes_no_registry_and_an_emptied_or_foreign_one_is_said(root, tmp_path):
    file = root / "registry.sqlite"
    file.rename(tmp_path / "kept.sqlite")
    done = bench("registry", "rebuild", "--check", "--out", root)
    assert (done.exit_code, file.exists()) == (2, False)
    for kind in ("emptied", "foreign"):
        if kind == "foreign":
            register([calibrated(tmp_path / "elsewhere", "run", "2026-11-21T06:00:00+00:00")])
            shutil.copy(tmp_path / "elsewhere" / "registry.sqlite", file)
        else:
            file.write_bytes(b"")
        for command in ("list", "equipment list"):
            done = bench("registry", *command.split(), "--out", root)
            assert (done.exit_code, "knows nothing of this archive" in done.stderr) == (2, True), kind
    file.unlink()
    (root / "ledger.jsonl").unlink()
    (root / "chain.seal").unlink()
    shutil.copy(tmp_path / "kept.sqlite", file)
    assert "ledger.jsonl, which belongs to this registry, is missing" in bench("registry", "list", "--out", root).stderr


def test_a_row_that_is_not_what_its_folder_says_is_said(root):
    from bench.archive.registry.opening import open_registry
    from bench.archive.registry.writing import TABLES

    with open_registry(root / "registry.sqlite") as registry, registry.writing() as connection:
        connection.execute(TABLES["runs"].update().values(state="aborted"))
    for command in ("list", "show SIM-0001", "show SIM-0001/right"):
        done = bench("registry", *command.split(), "--out", root)
        assert (done.exit_code, "is not what its folder says" in done.stderr) == (2, True), command


def test_a_folder_that_cannot_be_written_is_one_line(root, monkeypatch):
    def refused(path, data, **options):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("bench.record.chain.write_atomically", refused)
    done = bench("report", root / "SIM-0001" / "right")
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert "cannot be read or written: Permission denied" in done.stderr


def test_limits_models_and_events_that_were_altered_are_refused_by_report(root):
    for name in ("limits.yaml", "model.yaml", "events.jsonl", "data.parquet", "means.parquet"):
        run = make_run(root / "SIM-0002" / name, COLUMNS, unit="SIM-0002", run=name)
        if name.endswith("yaml"):
            keep(run, name, "name: a\n")
        (run / name).write_bytes(b"name: b\n")
        done = bench("report", run)
        assert (done.exit_code, f"{name}: is not the file that was recorded" in done.stderr) == (2, True), done.output
        (run / name).unlink()
        assert f"{name}: is missing" in bench("report", run).stderr


def test_a_manifest_that_the_ledger_did_not_see_is_not_flashed(root):
    run = root / "SIM-0001" / "right"
    Manifest.read(run).model_copy(update={"cause": "another"}).write(run)
    keep(run, "calibration.json", FIT)
    done = bench("flash", "SIM-0001", "--out", root, "--run", run, "--quiet")
    assert (done.exit_code, "the ledger of the archive saw" in done.stderr) == (2, True), done.output
