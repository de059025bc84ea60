"""The registry on SQLite and PostgreSQL: rows of the run folders, never lost, never more than the folders say."""

import hashlib
import json
import multiprocessing
import os
import shutil
import sqlite3
import uuid
from datetime import date
from functools import partial
from itertools import count
from types import SimpleNamespace

import pytest
import sqlalchemy

from bench.archive.fleet.listing import listing
from bench.archive.registry import rows as rows_module
from bench.archive.registry import summaries
from bench.archive.registry.asking import runs
from bench.archive.registry.ledger import archive
from bench.archive.registry.opening import SCHEMA, open_registry
from bench.archive.registry.rebuild import rebuild
from bench.archive.registry.tables import Table
from bench.archive.registry.writing import TABLES, register, stored, tell
from bench.base.errors import InputError
from bench.record import chain as chain_module
from bench.record import faults
from bench.record import lines as lines_module
from bench.record.folder import RunFolder
from bench.record.records.lot import LotRecord
from tests.support.databases import binaries, database, postgres
from tests.support.run_folders import keep, make_run
from tests.support.unit_history import UNIT, unit_with_history

NUMBERS = count()
THERMOMETER = {"kind": "equipment", "name": "Pt100", "serial": "7", "type": "sensor", "due_on": "2027-01-31"}


@pytest.mark.parametrize("unit", ["G", None])
def test_runs_of_one_unit_are_not_compared_each_with_each(tmp_path, unit):
    """Thousands of runs of a golden unit: twice the runs, twice the steps of the database."""
    steps = []
    for number in (200, 400):
        with open_registry(tmp_path / f"{number}.sqlite") as registry:
            with registry.writing() as connection:
                connection.execute(TABLES["archives"].insert(), {"id": "a", "path": "a"})
                connection.execute(TABLES["units"].insert(), {"serial": "G", "archive": "a"})
                rows = [{"id": f"a/{i}", "archive": "a", "path": f"{i}", "unit": "G", "manifest_sha256": f"{i}"}
                        for i in range(number)]  # fmt: skip
                connection.execute(TABLES["runs"].insert(), rows)
            count = []
            with registry.reading() as connection:
                connection.connection.driver_connection.set_progress_handler(partial(count.append, 1), 100)
            assert len(runs(registry, unit)) == number
            steps.append(len(count))
    assert 0 < steps[1] < 3 * steps[0]


def test_a_registry_is_made_with_one_look_into_the_folders_of_a_unit(tmp_path, monkeypatch):
    unit_with_history(tmp_path)
    looked = []
    monkeypatch.setattr(rows_module, "verified_in", lambda unit: looked.append(unit) or {})
    rows_module.of_archive(archive(tmp_path))
    assert looked == [tmp_path / UNIT]


@pytest.fixture(scope="module")
def server():
    programs = binaries()
    if programs is None:
        if os.environ.get("BENCH_CI"):
            pytest.fail("CI must have PostgreSQL: apt-get install postgresql")
        pytest.skip("PostgreSQL is not installed")
    with postgres(programs) as url:
        yield url


@pytest.fixture(params=["sqlite", "postgresql"])
def where(request, tmp_path):
    """URL or file of a registry that does not exist yet."""
    if request.param == "sqlite":
        return str(tmp_path / "registry.sqlite")
    return database(request.getfixturevalue("server"), f"bench_{uuid.uuid4().hex}")


def calibration(value=1.0):
    return {
        "verdict": {"verdict": "adequate"},
        "noise": {"floor_dph": 0.1, "coefficients": [{"name": "white", "value": 0.01, "determined": True}]},
        "residual": {"rms_dph": 0.11, "held_out": [{"by": "blocks", "rms_dph": 0.12}]},
        "calibration": {
            "model": {"name": "spline"},
            "coefficients": [{"key": "spline.piece1.a0", "value": value}],
            "parameters": [],
            "validity": {"temperature": {"from": -40.0, "to": 85.0, "unit": "degC"}},
        },
    }


def folder_of_run(root, unit="U-1", value=1.0):
    """A run folder with a calibration; its time series is of no interest here."""
    number = next(NUMBERS)
    path = root / unit / f"run{number:04d}"
    make_run(path, {"time": [0.5, 1.5], "rate": [1.0, 2.0], "temperature": [20.0, 21.0]}, unit=unit, run=path.name,
             profile="quick", station="simulated", created=f"2026-11-01T00:{number % 60:02d}:00+00:00")  # fmt: skip
    keep(path, "calibration.json", calibration(value))
    return RunFolder(path)


@pytest.fixture
def root(tmp_path):
    path = tmp_path / "reports"
    archive(path)
    return path


def rows_of(registry, root):
    with registry.reading() as connection:
        return stored(connection, archive(root).id)


def test_a_run_is_registered_with_all_that_its_folder_says(where, root):
    run = folder_of_run(root)
    with open_registry(where) as registry:
        register(registry, run, archive(root))
        rows = rows_of(registry, root)
    (found,) = rows["runs"].values()
    assert (found["unit"], found["profile"], found["state"]) == ("U-1", "quick", run.manifest().state)
    (calibrated,) = rows["calibrations"].values()
    assert calibrated["verdict"] == "adequate"
    assert calibrated["model"] == "spline"
    assert calibrated["validity"]["temperature"]["to"] == 85.0
    assert {key[1]: row["value"] for key, row in rows["quantities"].items()} == {
        "noise_floor_dph": 0.1,
        "fit_rms_dph": 0.11,
        "residual_rms_dph": 0.12,
        "angle_random_walk_dprh": 0.01,
    }


def test_registering_again_replaces_what_was_known_of_the_run_and_keeps_what_people_told(where, root):
    run, ledger = folder_of_run(root), archive(root)
    with open_registry(where) as registry:
        register(registry, run, ledger)
        tell(registry, ledger, {"kind": "lot", "lot": "A", "units": ["U-1"]})
        before = rows_of(registry, root)
        keep(run.path, "calibration.json", calibration(2.0))
        register(registry, run, ledger)
        after = rows_of(registry, root)
    assert after["units"] == before["units"]
    assert after["units"][("U-1",)]["lot"] == "A"
    (first,), (second,) = before["calibrations"].values(), after["calibrations"].values()
    assert first["coefficients_sha256"] != second["coefficients_sha256"]


def test_a_lost_registry_is_made_again_with_the_same_rows(where, root, tmp_path):
    ledger = archive(root)
    with open_registry(where) as registry:
        for unit in ("U-1", "U-2"):
            register(registry, folder_of_run(root, unit), ledger)
        tell(registry, ledger, THERMOMETER)
        tell(registry, ledger, {"kind": "operator", "name": "Ada"})
        tell(registry, ledger, {"kind": "lot", "lot": "B", "units": ["U-2", "U-3"]})
        before = rebuild(registry, ledger, only_compare=True)
    assert before.differences == ()
    with open_registry(tmp_path / "new.sqlite") as registry:
        after = rebuild(registry, ledger)
        assert rows_of(registry, root)["equipment"][("Pt100", "7")]["due_on"] == date(2027, 1, 31)
    assert len(after.differences) == sum(after.counts.values())
    assert after.digest == before.digest


def test_a_rebuild_says_every_row_that_differed_and_puts_it_right(where, root):
    ledger, run, gone = archive(root), folder_of_run(root), folder_of_run(root, "U-9")
    forgotten = folder_of_run(root, "U-2")
    with open_registry(where) as registry:
        register(registry, run, ledger)
        register(registry, gone, ledger)
        with registry.writing() as connection:
            connection.execute(TABLES["calibrations"].update().values(verdict="forged"))
        for file in gone.path.iterdir():
            file.unlink()
        compared = rebuild(registry, ledger, only_compare=True)
        said = "\n".join(rebuild(registry, ledger).differences)
        again = rebuild(registry, ledger)
    assert compared.differences
    assert 'verdict is "forged", on disk "adequate"' in said
    assert f"runs {ledger.id}/U-9/{gone.path.name}: in the registry, but not on disk" in said
    assert f"runs {ledger.id}/U-2/{forgotten.path.name}: missing in the registry" in said
    assert again.differences == ()
    assert again.counts["runs"] == 2
    assert again.counts["units"] == 2


def test_a_folder_that_cannot_be_read_is_named_and_stops_nothing(where, root):
    good, broken = folder_of_run(root), folder_of_run(root)
    (broken.path / "manifest.json").write_text("{")
    with open_registry(where) as registry:
        found = rebuild(registry, archive(root))
    assert found.counts["runs"] == 1
    assert len(found.unreadable) == 1
    assert str(broken.path) in found.unreadable[0]
    assert good.path.exists()


def test_the_calibration_of_a_lot_is_no_run_of_a_unit(where, root):
    """`bench lot calibrate` registers nothing; neither does a rebuild, so that a fleet has no unit that nobody made."""
    folder_of_run(root)
    lot = folder_of_run(root, "L-7")
    LotRecord(lot="L-7", model="m", runs=("r",), borders_degc=(0.0, 1.0), units=()).write(lot.path)
    with open_registry(where) as registry:
        rebuilt = rebuild(registry, archive(root))
        assert rebuilt.counts["runs"] == 1
        register(registry, lot, archive(root))
        assert [row["unit"] for row in runs(registry)] == ["U-1"]


def test_archives_that_share_a_registry_leave_each_other_alone(where, root, tmp_path):
    other = tmp_path / "other"
    first, second = archive(root), archive(other)
    with open_registry(where) as registry:
        register(registry, folder_of_run(root, "U-1"), first)
        register(registry, folder_of_run(other, "U-1"), second)
        tell(registry, second, {"kind": "lot", "lot": "A", "units": ["U-1"]})
        register(registry, folder_of_run(root, "U-1"), first)
        assert rebuild(registry, first).differences == ()
        assert rebuild(registry, second).differences == ()
        with registry.reading() as connection:
            assert connection.execute(sqlalchemy.text("SELECT count(*) FROM runs")).scalar() == 3
            assert connection.execute(sqlalchemy.text("SELECT lot FROM units")).scalar() == "A"


def _station(where, root, numbers, gate):
    gate.wait()
    ledger = archive(root)
    for number in numbers:
        path = next(root.glob(f"*/run-{number}"))
        with open_registry(where) as registry:
            register(registry, RunFolder(path), ledger)
            tell(registry, ledger, {"kind": "operator", "name": f"operator {number}"})


@pytest.mark.slow
def test_stations_at_once_lose_no_row(where, root):
    stations, each = 4, 8
    for number in range(stations * each):
        run = folder_of_run(root, unit=f"U-{number % 3}")
        run.path.rename(run.path.with_name(f"run-{number}"))
    spawn = multiprocessing.get_context("spawn")
    gate = spawn.Barrier(stations)
    parts = [range(station * each, (station + 1) * each) for station in range(stations)]
    processes = [spawn.Process(target=_station, args=(where, root, list(part), gate)) for part in parts]
    for process in processes:
        process.start()
    for process in processes:
        process.join(120)
        assert process.exitcode == 0
    with open_registry(where) as registry:
        found = rebuild(registry, archive(root), only_compare=True)
    assert found.differences == ()
    assert found.counts["runs"] == stations * each
    assert found.counts["operators"] == stations * each


def test_a_new_registry_that_another_station_writes_at_that_moment_is_opened_when_it_has_ended(tmp_path, monkeypatch):
    where = tmp_path / "registry.sqlite"
    other = sqlite3.connect(where, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    waits = []

    def waited(seconds):
        waits.append(seconds)
        other.execute("COMMIT")

    monkeypatch.setattr("time.sleep", waited)
    with open_registry(where) as registry, registry.reading() as connection:
        assert connection.execute(sqlalchemy.text("PRAGMA journal_mode")).scalar() == "wal"
    assert len(waits) == 1
    other.close()


def test_a_ledger_that_others_write_meanwhile_is_read_again(root, monkeypatch):
    ours, theirs, overtaken = archive(root), archive(root), []
    check = chain_module._check

    def late(*given):
        if not overtaken:
            overtaken.append(given)
            for number in (1, 2, 3):
                theirs.append({"kind": "operator", "name": f"operator {number}"})
        check(*given)

    monkeypatch.setattr(chain_module, "_check", late)
    assert [entry.get("name") for entry in ours.entries()] == ["operator 1", "operator 2", "operator 3"]


def test_the_migrations_make_the_tables_that_the_code_means(where):
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext
    from alembic.script import ScriptDirectory

    from bench.archive.registry import opening

    with open_registry(where) as registry, registry.reading() as connection:
        context = MigrationContext.configure(connection)
        assert compare_metadata(context, Table.metadata) == []
    assert ScriptDirectory(str(opening._MIGRATIONS)).get_current_head() == SCHEMA


def test_a_registry_of_an_older_bench_is_updated_once_and_says_how_far_it_is(tmp_path, root, monkeypatch, capsys):
    path = tmp_path / "registry.sqlite"
    with open_registry(path) as registry:
        for unit in ("U-1", "U-2", "U-3"):
            register(registry, folder_of_run(root, unit), archive(root))
        with registry.writing() as connection:
            for older in ("DROP TABLE summaries", "DROP INDEX ix_runs_station", "DROP INDEX ix_units_lot",
                          "UPDATE alembic_version SET version_num = '0005'"):  # fmt: skip
                connection.execute(sqlalchemy.text(older))
    monkeypatch.setattr(summaries, "_AT_ONCE", 1)
    monkeypatch.setattr(summaries, "_TOLD", 2)
    for said in (["0 of 3 units", "2 of 3 units"], []):
        with open_registry(path) as registry:
            assert listing(registry, "u-", None, "newest", 10, 0).matched == 3
        lines = capsys.readouterr().err.splitlines()
        assert [line.partition("for this bench: ")[2] for line in lines] == said


def test_the_structure_of_a_small_registry_is_checked_and_that_of_a_large_one_by_verify_archive(
    tmp_path, root, monkeypatch
):
    from bench.archive.registry import opening
    from bench.commands.scrubbing import verify_archive

    path = root / "registry.sqlite"
    with open_registry(path) as registry:
        for unit in range(40):
            register(registry, folder_of_run(root, f"U-{unit}"), archive(root))
    with sqlite3.connect(path) as database:
        (page,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'ix_runs_station'").fetchone()
    with path.open("r+b") as file:
        file.seek((page - 1) * 4096)
        file.write(bytes(4096))
    advice = r"; move it away, and make it again with `bench registry rebuild`"
    with pytest.raises(InputError, match=rf"(damaged|malformed).*{advice}"):
        open_registry(path, checked=True)
    monkeypatch.setattr(opening, "_CHECKED_BYTES", 1000)
    open_registry(path, checked=True).close()
    assert any("move it away" in fault for fault in verify_archive(root).faults)


def test_a_newer_schema_is_refused_in_one_line_and_left_alone(where):
    with open_registry(where) as registry, registry.writing() as connection:
        connection.execute(sqlalchemy.text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(InputError, match=r"schema 9999 is newer than this bench knows .*--registry") as refused:
        open_registry(where)
    assert "\n" not in str(refused.value)


def test_a_database_of_something_else_is_refused(where):
    import sqlalchemy as sa

    from bench.archive.registry.opening import _engine, _url

    engine = _engine(_url(where))
    with engine.begin() as connection:
        connection.execute(sa.text("CREATE TABLE customers (id INTEGER)"))
    engine.dispose()
    with pytest.raises(InputError, match="holds other tables"):
        open_registry(where)


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("postgresql://bench:secret@127.0.0.1:1/x", "refused"),
        ("mysql://somebody@host/x", "not supported|No module"),
        ("nowhere/registry.sqlite", "folder does not exist"),
        ("nonsense://", "registry: "),
    ],
)
def test_a_registry_that_cannot_be_opened_is_one_line_without_the_password(where, said):
    with pytest.raises(InputError, match=said) as refused:
        open_registry(where)
    assert "\n" not in str(refused.value)
    assert "secret" not in str(refused.value)


def test_the_ledger_says_which_line_is_broken(root):
    ledger = archive(root)
    ledger.append(THERMOMETER)
    keep(root, ledger.path.name, ledger.path.read_text() + "{\n")
    with pytest.raises(InputError, match=r"ledger\.jsonl:3: "):
        ledger.entries()


def test_an_archive_keeps_its_id_when_it_is_moved(where, root, tmp_path):
    run, ledger = folder_of_run(root), archive(root)
    with open_registry(where) as registry:
        register(registry, run, ledger)
        root.rename(tmp_path / "elsewhere")
        moved = archive(tmp_path / "elsewhere")
        found = rebuild(registry, moved)
    assert moved.id == ledger.id
    assert [line.split(":")[0] for line in found.differences] == [f"archives {ledger.id}"]


def test_a_copy_of_an_archive_takes_no_rows_of_the_first_one(where, root, tmp_path):
    """A cloned disk has the same id: whoever is second is told to say what it is."""
    folder_of_run(root)
    with open_registry(where) as registry:
        rebuild(registry, archive(root))
        clone = tmp_path / "clone"
        shutil.copytree(root, clone)
        own = folder_of_run(clone, "U-2")
        for attempt in (
            lambda: rebuild(registry, archive(clone)),
            lambda: register(registry, own, archive(clone)),
            lambda: tell(registry, archive(clone), THERMOMETER),
        ):
            with pytest.raises(InputError, match=r"--moved.*--copied"):
                attempt()
        assert "Pt100" not in (clone / "ledger.jsonl").read_text()
        assert archive(clone).renewed().id == archive(clone).id != archive(root).id
        assert list(archive(clone).broken()) == []
        assert rebuild(registry, archive(clone)).counts["runs"] == 2
        assert rebuild(registry, archive(root), only_compare=True).differences == ()
        listed = runs(registry)
        assert [row["unit"] for row in listed].count("U-1") == 1  # its folder is in both


def test_what_the_registry_refuses_is_not_in_the_ledger(root, tmp_path):
    path = tmp_path / "registry.sqlite"
    open_registry(path).close()
    with open_registry(path) as registry:
        with registry.reading() as connection:
            connection.exec_driver_sql("PRAGMA query_only = ON")
        with pytest.raises(InputError, match="readonly"):
            tell(registry, archive(root), THERMOMETER)
    assert "Pt100" not in (root / "ledger.jsonl").read_text()


@pytest.fixture
def hashed(monkeypatch):
    """Sizes of what the chain and the ledger hash."""
    sizes, sha256 = [], hashlib.sha256
    counted = SimpleNamespace(sha256=lambda data=b"": sizes.append(len(data)) or sha256(data))
    for module in (chain_module, lines_module):
        monkeypatch.setattr(module, "hashlib", counted)
    return sizes


def filled(root, runs=200):
    ledger = archive(root)
    ledger.saw_all([(f"U-{number}/r", f"{number:064x}") for number in range(runs)])
    return ledger


def older(root, runs):
    """One of an older bench: each line has the SHA-256 of the whole file before it, the seal is that of the file."""
    text = json.dumps({"kind": "archive", "id": "a" * 12}) + "\n"
    for number in range(runs):
        previous = hashlib.sha256(text.encode()).hexdigest()
        line = {"kind": "run", "run": f"U-{number}/r", "manifest": "b" * 64, "previous": previous}
        text += json.dumps(line) + "\n"
    chain_module.put(root, {"ledger.jsonl": text.encode()})
    return archive(root)


def test_a_run_that_is_registered_adds_a_line_and_no_other_line_is_hashed(tmp_path, hashed):
    ledger = filled(tmp_path)
    before = ledger.path.stat()
    hashed.clear()
    assert ledger.saw("U-200/r", "c" * 64) == {"U-200/r": (202, "c" * 64)}
    assert sum(hashed) < 1000
    assert ledger.path.stat().st_ino == before.st_ino
    assert ledger.saw("U-1/r", "d" * 64) == {"U-1/r": (3, "d" * 64)}
    assert [ledger.seen()[run] for run in ("U-1/r", "U-200/r")] == [(3, "d" * 64), (202, "c" * 64)]
    whole = ledger.path.read_bytes()
    assert ledger.saw("U-200/r", "c" * 64) == {"U-200/r": (202, "c" * 64)}
    assert ledger.path.read_bytes() == whole
    assert [*ledger.broken(), *faults(tmp_path)] == []


def test_a_ledger_of_an_older_bench_is_hashed_once_and_stays_proven(tmp_path, hashed):
    ledger = older(tmp_path, 50)
    assert len(ledger.seen()) == 50
    ledger.saw("U-50/r", "c" * 64)
    hashed.clear()
    ledger.saw("U-51/r", "c" * 64)
    assert sum(hashed) < 1000
    assert [*ledger.broken(), *faults(tmp_path)] == []
    ledger.path.write_text(ledger.path.read_text().replace("U-7/r", "U-8/r"))
    assert any("continues a file" in fault for fault in ledger.broken())
    assert any("is not the file that was recorded" in fault for fault in faults(tmp_path))
    with pytest.raises(InputError, match="is not the file that was recorded"):
        ledger.saw("U-52/r", "c" * 64)


@pytest.mark.parametrize("made", [filled, older])
@pytest.mark.parametrize("torn", [b"", b'{"kind": "oper', b"\0" * 40 + b"\n"])
def test_lines_that_a_power_cut_interrupted_are_kept_and_sealed(tmp_path, monkeypatch, capsys, made, torn):
    """Five lines were being added: two of them are whole, the seal lists none or all."""
    ledger, write = made(tmp_path, 3), chain_module._write
    before = ledger.path.read_bytes()

    def cut(folder, known, *, sync=True):
        if not sync:
            raise KeyboardInterrupt
        write(folder, known)

    monkeypatch.setattr(chain_module, "_write", cut)
    with pytest.raises(KeyboardInterrupt):
        ledger.append(*({"kind": "operator", "name": f"operator {number}"} for number in range(5)))
    monkeypatch.setattr(chain_module, "_write", write)
    added = ledger.path.read_bytes()[len(before) :].splitlines(keepends=True)
    ledger.path.write_bytes(before + b"".join(added[:2]) + torn)
    capsys.readouterr()
    assert [entry["name"] for entry in archive(tmp_path).entries()[3:]] == ["operator 0", "operator 1"]
    said = capsys.readouterr().err
    assert (said.count("\n"), "the 2 that are whole are kept" in said) == (1, True)
    archive(tmp_path).append({"kind": "operator", "name": "Ada"})
    assert [*ledger.broken(), *faults(tmp_path), capsys.readouterr().err] == [""]
    assert len(ledger.entries()) == 6


def test_lines_that_nobody_was_adding_are_refused(tmp_path):
    ledger = filled(tmp_path, 3)
    with ledger.path.open("ab") as file:
        file.write(b'{"kind": "operator", "name": "Eve"}\n')
    for attempt in (ledger.entries, lambda: ledger.saw("U-9/r", "a" * 64)):
        with pytest.raises(InputError, match="is not the file that was recorded"):
            attempt()


def test_a_line_of_the_ledger_that_a_power_cut_left_in_part_is_dropped(tmp_path):
    ledger = archive(tmp_path)
    ledger.saw("U-1/r", "a" * 64)
    with ledger.path.open("ab") as file:
        file.write(b'{"kind": "archive", "id"')
    assert archive(tmp_path) == ledger
    assert ledger.saw("U-2/r", "b" * 64) == {"U-2/r": (3, "b" * 64)}
    assert [*ledger.broken(), *faults(tmp_path)] == []


def test_a_role_that_may_only_read_reads_and_is_refused_in_one_line_where_it_writes(server, root):
    import psycopg

    url, name = database(server, f"bench_{uuid.uuid4().hex}"), f"reader_{uuid.uuid4().hex}"
    run = folder_of_run(root)
    with open_registry(url) as registry:
        register(registry, run, archive(root))
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute(f"CREATE ROLE {name} LOGIN")
        connection.execute(f"GRANT SELECT ON ALL TABLES IN SCHEMA public TO {name}")
    with open_registry(url.replace("//bench@", f"//{name}@")) as registry:
        assert [row["unit"] for row in runs(registry)] == ["U-1"]
        assert listing(registry, "u-1", None, "newest", 10, 0).matched == 1
        with pytest.raises(InputError, match="permission denied for table") as refused:
            register(registry, run, archive(root))
    assert "\n" not in str(refused.value)
