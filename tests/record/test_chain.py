"""The chain of a folder: what is listed, signed and refused, and that a kill leaves nothing that must be refused."""

from __future__ import annotations

import json
import shutil

import pyarrow.parquet as pq
import pytest

from bench.base.errors import InputError
from bench.record import CalibrationRecord, LimitsRecord, Manifest, RunFolder, chain, put, seconds_of, signing
from bench.record.chain import CHAIN, chain_of, faults, prove, unproven, use
from tests.support.run_folders import make_run

COLUMNS = {"time": [0.5, 1.5, 2.5], "rate": [1.0, 2.0, 3.0], "temperature": [20.0, 21.0, 22.0]}


@pytest.fixture
def run(tmp_path):
    """A run folder with a calibration."""
    folder = make_run(tmp_path / "run", COLUMNS)
    CalibrationRecord(unit="SIM-0001").write(folder)
    return folder


def test_every_file_of_a_folder_is_proven(run):
    prove(run)
    known = chain_of(run)
    assert (known.unit, known.run) == ("SIM-0001", "run")
    assert known.files["calibration.json"].made_from == {"manifest.json": known.files["manifest.json"].sha256[0]}


@pytest.mark.parametrize("name", ["calibration.json", "manifest.json"])
def test_an_altered_record_is_refused_with_both_hashes(run, name):
    text = (run / name).read_text()
    (run / name).write_text(text.replace("SIM-0001", "SIM-0002"))
    wanted = chain_of(run).files[name].sha256[0]
    with pytest.raises(
        InputError, match=rf"{name}: is not the file that was recorded: its SHA-256 is \w+, .* {wanted}"
    ):
        (CalibrationRecord if name.startswith("cal") else Manifest).find(run)


def test_a_record_that_is_replaced_while_it_is_read_is_read_again(run, monkeypatch):
    known, replaced = chain.check, iter([CalibrationRecord(unit="SIM-0002")])

    def check(*given):
        for newer in replaced:
            newer.write(run)
        return known(*given)

    monkeypatch.setattr(chain, "check", check)
    assert CalibrationRecord.read(run).unit == "SIM-0002"


def test_a_record_that_is_missing_or_foreign_is_refused(run):
    (run / "limits.json").write_text('{"verdict": "PASS"}')
    with pytest.raises(InputError, match=r"limits\.json: is not listed in chain\.seal"):
        LimitsRecord.find(run)
    (run / "calibration.json").unlink()
    with pytest.raises(InputError, match=r"calibration\.json: is missing; chain\.seal lists it"):
        CalibrationRecord.find(run)


def test_a_result_of_another_manifest_is_stale(run):
    Manifest.read(run).model_copy(update={"state": "aborted"}).write(run)
    with pytest.raises(InputError, match=r"was made from a manifest\.json with the SHA-256"):
        CalibrationRecord.find(run)


def test_what_was_recorded_is_refused_when_it_is_another_file_and_hashed_only_after_a_change(run, monkeypatch):
    data = RunFolder(run).data
    monkeypatch.setattr(chain, "sha256", lambda path: pytest.fail("hashed"))
    use(run, data.name)  # a look at a file that did not change since it was hashed
    monkeypatch.undo()
    data.write_bytes(data.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"data\.parquet: is not the file that was recorded"):
        use(run, data.name)


def test_a_damaged_page_is_noticed_even_where_no_hash_is(run):
    path = RunFolder(run).means
    content = bytearray(path.read_bytes())
    column = pq.ParquetFile(path).metadata.row_group(0).column(0)
    start = column.dictionary_page_offset or column.data_page_offset
    content[start + column.total_compressed_size - 2] ^= 1
    path.write_bytes(content)
    (run / CHAIN).unlink()
    manifest = json.loads((run / "manifest.json").read_text())
    (run / "manifest.json").write_text(json.dumps({**manifest, "files": {}}))
    with pytest.raises(InputError, match="not a readable Parquet file"):
        seconds_of(run)


def test_an_altered_list_is_refused_and_another_bench_is_not_trusted(run, tmp_path, monkeypatch):
    shutil.copytree(run, tmp_path / "copy")
    (run / CHAIN).write_text((run / CHAIN).read_text().replace("SIM-0001", "SIM-0002"))
    with pytest.raises(InputError, match=r"chain\.seal: was altered"):
        Manifest.find(run)
    with pytest.raises(InputError, match=r"chain\.seal: was altered"):
        CalibrationRecord().write(run)
    public = (signing.keys_folder() / signing.PUBLIC).read_text()
    monkeypatch.setenv("BENCH_KEYS", str(tmp_path / "keys"))
    assert Manifest.find(tmp_path / "copy") is not None
    CalibrationRecord(unit="SIM-0001").write(tmp_path / "copy")  # signed by both now
    with pytest.raises(InputError, match=r"of another bench; to trust it, copy its bench\.pub into"):
        prove(tmp_path / "copy")
    (tmp_path / "keys" / "other.pub").write_text(public)
    prove(tmp_path / "copy")


def test_a_folder_of_an_older_bench_opens_and_says_what_is_needed(run):
    (run / CHAIN).unlink()
    assert CalibrationRecord.find(run) is not None
    assert "certificate and flash need one" in unproven(run)
    with pytest.raises(InputError, match=r"no chain\.seal: an older bench"):
        prove(run)
    CalibrationRecord(unit="SIM-0001").write(run)
    prove(run)
    assert chain_of(run).adopted


@pytest.mark.parametrize("written", [0, 1, 2, 3])
def test_a_kill_between_two_files_leaves_a_folder_that_opens(run, monkeypatch, written):
    """The chain, two files and the chain again are written; the bench is killed before one of them."""
    before = (run / "calibration.json").read_bytes()
    left = [written]
    atomically = chain.write_atomically

    def killed(path, data, **options):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        atomically(path, data, **options)

    monkeypatch.setattr(chain, "write_atomically", killed)
    files = {
        "calibration.json": CalibrationRecord(unit="SIM-0001", profile="new").text().encode(),
        "next.yaml": b"a: 1\n",
    }
    with pytest.raises(KeyboardInterrupt):
        put(run, files, ["manifest.json"])
    monkeypatch.undo()
    assert CalibrationRecord.read(run).profile == ("new" if written >= 2 else "")
    assert list(faults(run)) == []
    assert written >= 2 or (run / "calibration.json").read_bytes() == before
    CalibrationRecord(unit="SIM-0001").write(run)
    prove(run)


def test_a_key_that_cannot_be_made_costs_no_run_and_is_said(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BENCH_KEYS", str(tmp_path / "file" / "keys"))
    run = make_run(tmp_path / "run", COLUMNS)
    assert Manifest.read(run).unit == "SIM-0001"
    with pytest.raises(InputError, match="is not signed; give this user a place for its key"):
        prove(run)
