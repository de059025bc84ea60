"""`bench run --production`: equipment from a file or from the registry, none of it overdue."""

from pathlib import Path

import pytest

from bench.base.errors import InputError
from bench.deliver.certificate.laboratory import load_instruments
from tests.deliver.test_certificate import EQUIPMENT
from tests.support.commands import bench

PROFILE = Path(__file__).parents[2] / "profiles" / "quick.yaml"


def test_a_production_run_is_blocked_by_overdue_or_unknown_equipment(tmp_path):
    (tmp_path / "old.yaml").write_text(EQUIPMENT.replace("DUE", "2026-03-02"))
    for options, said in (
        (["--equipment", str(tmp_path / "old.yaml")], "due 2026-03-02"),
        ([], "a production run needs --equipment"),
    ):
        command = ["run", str(PROFILE), "--production", "--out", str(tmp_path / "out"), *options]
        done = bench(*command)
        assert done.exit_code == 2
        assert said in done.stderr
        assert not (tmp_path / "out").exists()


def production_run(out, monkeypatch, *equipment):
    """Output of `bench run --production` with equipment in the registry; the texts for its run folder."""
    kept = {}

    def job_of(profile, station, task):
        kept.update(task.texts)
        raise InputError("the run itself is of no interest here")

    monkeypatch.delenv("BENCH_REGISTRY", raising=False)
    monkeypatch.setattr("bench.commands.acquisition.job_of", job_of)
    out.mkdir()
    for name, *days in equipment:
        add = ["registry", "equipment", "add", name, "S-1", "--kind", "sensor", *days, "--out", str(out)]
        assert bench(*add).exit_code == 0
    done = bench("run", PROFILE, "--production", "--out", out)
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    return done.stderr, kept


def test_a_production_run_without_a_file_takes_the_registrys_equipment(tmp_path, monkeypatch):
    valid = ("Pt100", "--calibrated", "2026-03-01", "--due", "2999-03-01")
    said, kept = production_run(tmp_path / "out", monkeypatch, valid, ("time base",))
    assert "of no interest" in said
    (tmp_path / "equipment.yaml").write_text(kept["equipment.yaml"])
    tools = load_instruments(tmp_path / "equipment.yaml")
    assert [(tool.name, tool.serial, tool.model, str(tool.due)) for tool in tools] == [
        ("time base", "S-1", "sensor", "None"),
        ("Pt100", "S-1", "sensor", "2999-03-01"),
    ]


@pytest.mark.parametrize(
    ("equipment", "why"),
    [
        ([("Pt100", "--due", "2999-03-01"), ("table", "--due", "2026-03-01")], ": table S-1, due 2026-03-01"),
        ([], "equipment in the registry, which holds none"),
    ],
)
def test_a_production_run_is_blocked_by_a_registry_with_overdue_or_without_equipment(
    tmp_path, monkeypatch, equipment, why
):
    said, kept = production_run(tmp_path / "out", monkeypatch, *equipment)
    assert why in said
    assert not kept
