"""Run folders: made once, named safely, read strictly."""

from datetime import UTC, datetime

import pytest

from bench.base.errors import InputError
from bench.record import Manifest, RunFolder, create_run, open_run, write_atomically

CREATED = datetime(2026, 11, 21, 7, 0, tzinfo=UTC)


def test_a_folder_is_named_by_unit_time_and_profile_and_holds_its_inputs(tmp_path):
    run = create_run(tmp_path, "SN 1/7", "ramp ../up", CREATED, {"profile.yaml": "name: ü\n"})
    assert run.path == tmp_path / "SN-1-7" / "20261121T070000Z_ramp-..-up"
    assert (run.path / "profile.yaml").read_text(encoding="utf-8") == "name: ü\n"
    assert run.journal.is_dir()


def test_two_runs_of_one_second_get_folders_of_their_own(tmp_path):
    first, second = (create_run(tmp_path, "u", "p", CREATED).path for _ in range(2))
    assert second.name == f"{first.name}_2"


def test_a_manifest_is_read_as_it_was_written_and_its_files_are_hashed(tmp_path):
    run = create_run(tmp_path, "u", "p", CREATED, {"profile.yaml": "abc"})
    Manifest(state="done", files=run.hashes()).write(run.path)
    manifest = open_run(run.path).manifest()
    assert manifest.state == "done"
    assert manifest.files == {  # SHA-256 of "abc", FIPS 180-2 appendix B.1
        "profile.yaml": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    }


def test_nan_never_gets_into_a_manifest_and_the_old_one_stays(tmp_path):
    run = create_run(tmp_path, "u", "p", CREATED)
    Manifest(state="done").write(run.path)
    with pytest.raises(ValueError, match="not JSON compliant"):
        Manifest.model_construct(duration_s=float("nan")).write(run.path)
    assert run.manifest().state == "done"


def test_a_write_that_fails_leaves_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "file"
    write_atomically(path, b"old")
    with pytest.raises(TypeError):
        write_atomically(path, "text")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "manifest.json is missing"),
        ("{", "not valid JSON"),
        ("[]", "not a JSON object"),
        ('{"format": 2}', "is of format 2, this bench reads up to 1"),
    ],
)
def test_what_is_no_run_folder_is_refused(tmp_path, content, message):
    if content is not None:
        (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(InputError, match=message):
        open_run(tmp_path)


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such run folder"):
        open_run(tmp_path / "nowhere")


def test_a_run_without_events_has_none(tmp_path):
    assert list(RunFolder(tmp_path).events()) == []
