"""No place for the record: a full disk, or a run folder that somebody removes, ends with exit code 4 and its name."""

import errno
import json
import shutil

import pytest

from bench.acquisition.run import runner
from bench.acquisition.run.ending import cannot_record
from tests.support import acquisition
from tests.support.commands import bench

PROFILE = "name: short\nsegments:\n  - {kind: soak, duration_min: 0.5}\n"


@pytest.fixture
def profile(tmp_path):
    (tmp_path / "profile.yaml").write_text(PROFILE)
    return str(tmp_path / "profile.yaml")


def test_a_disk_that_does_not_take_the_tables_is_named(profile, tmp_path, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(runner, "assemble", full)
    answer = bench("run", profile, "--out", tmp_path / "out", "--quiet", "--model", "polynomial")
    (run,) = (tmp_path / "out" / "SIM-0001").iterdir()
    assert answer.exit_code == 4
    assert f"bench: cannot record: No space left on device: {run}, on the disk at /" in answer.stderr
    assert f"then `bench report {run}` makes the tables" in answer.stderr


@pytest.mark.parametrize("units", [1, 4])
def test_a_run_folder_that_is_removed_ends_the_run(units, tmp_path):
    def remove(station):
        shutil.rmtree(tmp_path / "out")

    if units == 4:
        from bench.base import config

        file = acquisition.STATION.parent / "four_units.yaml"
        settings = config.load_config(config.read_yaml(file), acquisition.StationSettings)
    else:
        settings = None
    job = acquisition.job(tmp_path / "out", acquisition.LONG, settings)
    result = runner.run_job(job, acquisition.at(10, remove))
    assert result.error.exit_code == 4
    assert len(result.units) == units
    for unit in result.units:
        assert "was removed while the run was under way" in str(unit.error)


def test_the_disk_is_named_by_where_it_is_mounted(tmp_path):
    text = cannot_record(OSError(errno.EROFS, "Read-only file system"), tmp_path)
    assert text.startswith(f"cannot record: Read-only file system: {tmp_path}, on the disk at /")


def test_a_run_that_was_resumed_is_registered(profile, tmp_path):
    out = tmp_path / "out"
    assert bench("run", profile, "--out", out, "--quiet", "--model", "polynomial").exit_code in (0, 1)
    (run,) = (path for path in (out / "SIM-0001").iterdir())
    shutil.rmtree(tmp_path / "killed", ignore_errors=True)
    killed = tmp_path / "killed" / "SIM-0001" / run.name
    shutil.copytree(run, killed)
    for name in ("manifest.json", "data.parquet", "means.parquet"):
        (killed / name).unlink()
    assert bench("resume", killed, "--json").exit_code in (0, 1)
    listed = json.loads(bench("registry", "list", "--out", tmp_path / "killed", "--json").stdout)
    assert [row["path"] for row in listed["runs"]] == [f"SIM-0001/{run.name}"]
