"""`bench registry` and what other commands do with it, as a user meets them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy import Engine, event, select

from bench.archive.registry.asking import show
from bench.archive.registry.ledger import archive
from bench.archive.registry.opening import FILE, open_registry
from bench.archive.registry.summaries import SUMMARIES
from bench.cli import rendering
from bench.cli.options import Registered
from bench.commands import Asked, register_runs
from tests.support.commands import bench
from tests.support.run_folders import keep, make_run, ramp_run


def answer(*arguments, code=0):
    said = bench(*arguments, "--json")
    assert said.exit_code == code, said.output
    return json.loads(said.stdout)


@pytest.fixture
def reports(tmp_path):
    root = tmp_path / "reports"
    for unit in ("U-1", "U-2"):
        make_run(root / unit / "r1", **ramp_run(), unit=unit, run="r1", created="2026-11-01T00:00:00+00:00")
    return root


def test_a_registry_is_made_from_run_folders_listed_and_shown(reports):
    assert len(answer("registry", "rebuild", "--out", reports)["differences"]) == 5
    listed = answer("registry", "list", "--out", reports)["runs"]
    assert [run["unit"] for run in listed] == ["U-2", "U-1"]  # the last one seen is the first
    assert len(answer("registry", "list", "--unit", "U-2", "--out", reports)["runs"]) == 1
    assert answer("registry", "show", "U-1", "--out", reports)["runs"][0]["path"] == "U-1/r1"
    for name in ("U-1/r1", reports / "U-1" / "r1", listed[1]["id"]):
        assert answer("registry", "show", name, "--out", reports)["run"]["unit"] == "U-1"
    assert "U-2" in bench("registry", "list", "--out", reports).output


def test_a_run_is_found_by_its_path_without_a_look_at_every_run(reports):
    answer("registry", "rebuild", "--out", reports)
    told = []

    def hear(_connection, _cursor, statement, parameters, *_):
        told.append((statement, parameters))

    with open_registry(reports / FILE) as registry, registry.reading() as connection:
        event.listen(Engine, "before_cursor_execute", hear)
        try:
            for name in ("U-1/r1", f"{archive(reports).id}/U-1/r1", "/mnt/line/U-1/r1"):
                assert show(registry, name)["run"]["unit"] == "U-1"
        finally:
            event.remove(Engine, "before_cursor_execute", hear)
        plans = [connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {asked}", given).all() for asked, given in told
                 if asked.startswith("SELECT")]  # fmt: skip
        steps = [step[3] for plan in plans for step in plan]
    assert steps
    assert not [step for step in steps if step.startswith("SCAN runs")]


def test_a_comparison_changes_nothing_and_fails_where_rows_differ(reports):
    answer("registry", "rebuild", "--out", reports)
    assert answer("registry", "rebuild", "--check", "--out", reports)["differences"] == []
    make_run(reports / "U-3" / "r1", **ramp_run(), unit="U-3", run="r1")
    for _ in range(2):
        found = answer("registry", "rebuild", "--check", "--out", reports, code=1)
        assert len(found["differences"]) == 2


@pytest.mark.parametrize("name", ["U-7", "r1"])
def test_a_name_that_is_nobodys_or_two_runs_is_bad_input(reports, name):
    answer("registry", "rebuild", "--out", reports)
    said = bench("registry", "show", name, "--out", reports)
    assert said.exit_code == 2
    assert said.stderr.count("\n") == 1


def test_without_a_registry_the_way_to_one_is_told(tmp_path):
    said = bench("registry", "list", "--out", tmp_path)
    assert said.exit_code == 2
    assert "bench registry rebuild" in said.stderr
    assert not list(tmp_path.iterdir())


def test_equipment_is_told_its_due_date_and_is_overdue_the_day_after(tmp_path):
    due = ("--kind", "sensor", "--calibrated", "2026-01-31", "--due", "2027-01-31", "--out", tmp_path)
    answer("registry", "equipment", "add", "Pt100", "7", *due)
    valid = answer("registry", "equipment", "list", "--on", "2027-01-31", "--out", tmp_path)
    late = answer("registry", "equipment", "list", "--on", "2027-02-01", "--out", tmp_path, code=1)
    assert [found["equipment"][0]["state"] for found in (valid, late)] == ["valid", "overdue"]
    renewed = ("--kind", "sensor", "--calibrated", "2027-02-02", "--due", "2028-02-02", "--out", tmp_path)
    answer("registry", "equipment", "add", "Pt100", "7", *renewed)
    assert len(answer("registry", "equipment", "list", "--on", "2027-02-03", "--out", tmp_path)["equipment"]) == 1


def test_a_due_date_before_the_calibration_is_refused(tmp_path):
    given = ("--kind", "sensor", "--calibrated", "2027-01-31", "--due", "2026-01-31", "--out", tmp_path)
    assert bench("registry", "equipment", "add", "Pt100", "7", *given).exit_code == 2
    assert not list(tmp_path.iterdir())


def test_lots_and_operators_survive_the_loss_of_the_registry(reports):
    answer("registry", "lot", "B", "U-1", "U-2", "--out", reports)
    answer("registry", "operator", "Ada", "--out", reports)
    digest = answer("registry", "rebuild", "--out", reports)["digest"]
    for file in reports.glob("registry.sqlite*"):
        file.unlink()
    again = answer("registry", "rebuild", "--out", reports)
    assert again["digest"] == digest
    assert answer("registry", "show", "U-1", "--out", reports)["unit"]["lot"] == "B"


def test_a_run_is_registered_beside_its_folder(reports):
    assert register_runs([reports / "U-1" / "r1"], None, begin=True) == ""
    assert answer("registry", "list", "--out", reports)["runs"][0]["path"] == "U-1/r1"


def test_a_registry_that_fails_is_a_warning_and_the_answer_stands(reports):
    warning = register_runs([reports / "U-1" / "r1"], "postgresql://bench@127.0.0.1:1/x", begin=True)
    assert warning.startswith("not registered: ")
    assert f"bench registry rebuild --out {reports}" in warning
    said = Registered(Asked("hold", "r1", {"state": "running"}), warning)
    assert said.exit_code == 1
    assert rendering.plain(said).endswith(f"\nwarning: {warning}")
    assert rendering.content(said)["registry"] == {"registered": False, "warning": warning}


def test_a_report_on_a_folder_outside_an_archive_makes_no_registry(reports):
    assert register_runs([reports / "U-1" / "r1"], None, begin=False) is None
    assert not list(reports.glob("*.*"))


KILLED = """
import os, sys
from pathlib import Path
from bench.acquisition import run_job
from tests.support import acquisition
job = acquisition.job(Path(sys.argv[1]), acquisition.LONG)
run_job(job, acquisition.at(10, lambda station: os._exit(9)))
"""


@pytest.mark.slow
def test_the_first_run_of_an_archive_is_registered_although_it_was_killed(tmp_path):
    root = str(Path(__file__).parents[2])
    command = [sys.executable, "-c", KILLED, str(tmp_path)]
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": root}, capture_output=True, text=True, check=False)
    assert done.returncode == 9, done.stderr
    (run,) = tmp_path.glob("*/*_long")
    assert bench("report", run, "--model", "polynomial").exit_code in {0, 1}
    assert [row["path"] for row in answer("registry", "list", "--out", tmp_path)["runs"]] == [f"SIM-0001/{run.name}"]


def test_an_import_is_registered(tmp_path):
    table = tmp_path / "log.csv"
    rows = "\n".join(f"{t},{10 + t / 100},{20 + t / 50}" for t in range(400))
    table.write_text(f"time,rate,temperature\n{rows}\n")
    root = tmp_path / "reports"
    answer("import", table, "--unit", "MINE", "--out", root)
    assert answer("registry", "list", "--out", root)["runs"][0]["unit"] == "MINE"


def test_a_recall_lists_what_rests_on_a_piece_of_equipment(reports):
    """A sensor turns out to be wrong: which runs, units and certificates rest on it?"""
    tool = (
        "{name: chamber sensor, model: Pt100, serial: PT-7, certificate: C-1, calibrated: 2026-01-01, due: 2027-01-01}"
    )
    make_run(reports / "U-3" / "r2", **ramp_run(), unit="U-3", run="r2", created="2026-11-05T00:00:00+00:00")
    for path in ("U-2/r1", "U-3/r2"):
        (reports / path / "equipment.yaml").write_text(f"equipment:\n  - {tool}\n")
    answer("registry", "rebuild", "--out", reports)
    found = answer("registry", "recall", "pt-7", "--out", reports)
    assert [(run["run"], run["unit"], run["certificates"]) for run in found["runs"]] == [
        ("U-2/r1", "U-2", []),
        ("U-3/r2", "U-3", []),
    ]
    assert (found["unknown"], found["elsewhere"]) == (1, 0)
    later = answer("registry", "recall", "chamber sensor", "--since", "2026-11-02", "--out", reports)
    assert [run["unit"] for run in later["runs"]] == ["U-3"]
    assert "no run rests on PT-9" in bench("registry", "recall", "PT-9", "--out", reports).output


def test_a_calibration_whose_verification_failed_is_none_that_passed(reports):
    """A unit is not within its limits where its own output is not; a verification that is spoilt says nothing of it."""
    run, check = reports / "U-1" / "r1", reports / "U-1" / "r2"
    for unit in ("U-1", "U-2"):
        folder = reports / unit / "r1"
        fit = {"model": {"name": "spline"}, "coefficients": [], "parameters": [], "validity": {}}
        keep(folder, "calibration.json", {"verdict": {"verdict": "adequate"}, "calibration": fit})
        keep(folder, "limits.json", {"name": "t", "verdict": "PASS"})
        register_runs([folder], None, begin=True)
    make_run(check, **ramp_run(), unit="U-1", run="r2", purpose="verification")

    def standing(word):
        keep(check, "verification.json", {"verdict": word, "calibration_run": str(run)})
        register_runs([check], None, begin=True)
        with open_registry(reports / FILE) as registry, registry.reading() as connection:
            return dict(connection.execute(select(SUMMARIES.c.serial, SUMMARIES.c.standing)).all())

    assert [standing(word) for word in ("PASS", "FAIL", "INVALID")] == [
        {"U-1": "pass", "U-2": "pass"}, {"U-1": "fail", "U-2": "pass"}, {"U-1": "pass", "U-2": "pass"},
    ]  # fmt: skip
    assert answer("registry", "rebuild", "--check", "--out", reports)["differences"] == []
