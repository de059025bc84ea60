"""Runs of many benches in one place: none lost, none twice, whatever is pulled, killed, copied or damaged."""

import json
import os
import shutil
import signal
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest

from bench.archive import Centre, archive, bring_back, fetch, newest, outbox, reached, release, scrub, send
from bench.archive.centre import claim as claiming
from bench.archive.centre.entries import read
from bench.archive.registry.opening import open_registry
from bench.archive.registry.writing import register_all
from bench.base import CentreError, InputError
from bench.commands import archive_of_centre, sync_fetch
from bench.record import MANIFEST, EntryRecord, RunFolder, faults, prove, put, sha256
from tests.support.centre_servers import s3, sftp
from tests.support.run_folders import keep, make_run, ramp_run


def bench_of(root, *units, times=1):
    """An archive of small runs."""
    ledger = archive(root)
    for unit in units:
        for number in range(times):
            record(ledger, unit, f"2026110{number + 1}T000000Z_ramp", number)
    return ledger


def record(ledger, unit, name, seed=0):
    folder = ledger.root / unit / name
    make_run(folder, **ramp_run(legs=(("soak", "soak", 25.0, 60.0),), seed=seed), unit=unit, run=name,
             created=f"2026-11-0{seed + 1}T00:00:00+00:00")  # fmt: skip
    ledger.saw(f"{unit}/{name}", sha256(folder / MANIFEST))
    return folder


def centre_at(tmp_path):
    return Centre(str(tmp_path / "centre"), begin=True)


def contents(folder):
    """Hash of each file of a folder that is not of its place only."""
    return {
        path.relative_to(folder).as_posix(): sha256(path)
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def manifests(root):
    return sorted(sha256(path) for path in root.glob(f"*/*/{MANIFEST}"))


def test_runs_arrive_as_they_are_and_travel_once(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1", "U-2"), centre_at(tmp_path)
    first, second = send(centre, ledger), send(centre, ledger)
    assert (len(first.sent), len(second.sent), second.files, second.there) == (2, 0, 0, 2)
    here = archive(tmp_path / "here")
    assert len(fetch(centre, here, large=True).folders) == 2
    assert fetch(centre, here, large=True).folders == []
    for run in ("U-1", "U-2"):
        name = f"{run}/20261101T000000Z_ramp"
        assert contents(here.root / name) == contents(ledger.root / name)
        prove(here.root / name)


def test_what_was_made_later_is_sent_and_fetched(tmp_path):
    ledger, centre, here = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path), archive(tmp_path / "here")
    send(centre, ledger)
    fetch(centre, here)
    put(ledger.root / "U-1" / "20261101T000000Z_ramp", {"note.json": b"{}"})
    done = send(centre, ledger)
    assert (done.sent, done.files) == (["U-1/20261101T000000Z_ramp"], 2)  # the new file, and the chain
    (folder,) = fetch(centre, here).folders
    assert (folder / "note.json").read_bytes() == b"{}"


def test_large_files_stay_at_the_centre_until_they_are_asked_for(tmp_path):
    ledger, centre, here = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path), archive(tmp_path / "here")
    send(centre, ledger)
    (folder,) = fetch(centre, here).folders
    assert not (folder / "data.parquet").exists()
    assert list(faults(folder)) == []
    with pytest.raises(InputError, match=r"data\.parquet: is not here; bring it back with `bench sync restore"):
        prove(folder)
    assert bring_back(centre, folder) == 1
    prove(folder)


KILLED = """
import os, signal, sys
from bench.archive import Centre, archive, send
from bench.archive.centre.store import Centre as Store
after, name = int(sys.argv[3]), sys.argv[4]
work, count = getattr(Store, name), 0
def killed(self, *given):
    global count
    count += 1
    if count == after:
        os.kill(os.getpid(), signal.SIGKILL)
    return work(self, *given)
setattr(Store, name, killed)
send(Centre(sys.argv[1], begin=True), archive(__import__("pathlib").Path(sys.argv[2])))
"""


@pytest.mark.parametrize(("where", "after"), [("_settle", 5), ("put", 7), ("write", 4), ("write", 5)])
def test_a_killed_bench_goes_on_where_it_was(tmp_path, where, after):
    ledger = bench_of(tmp_path / "a", "U-1", times=3)
    command = [sys.executable, "-c", KILLED, str(tmp_path / "centre"), str(ledger.root), str(after), where]
    assert subprocess.run(command, check=False, cwd=Path(__file__).parents[2]).returncode == -signal.SIGKILL
    centre = centre_at(tmp_path)
    before = {name for name in centre.names("files")}
    assert len(newest(centre)) < 3
    assert scrub(centre).faults == []  # what is listed is whole
    send(centre, ledger)
    assert before <= set(centre.names("files"))
    here = archive(tmp_path / "here")
    fetch(centre, here)
    assert manifests(here.root) == manifests(ledger.root)


def test_an_offline_bench_knows_what_waits_and_loses_nothing(tmp_path, monkeypatch):
    ledger, centre = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path)
    send(centre, ledger)
    for number in (1, 2):
        record(ledger, "U-1", f"2026110{number + 1}T000000Z_ramp", number)
    real, sent = centre._fs.put_file, []

    def pulled(*given):
        if len(sent) == 5:
            raise OSError(101, "Network is unreachable")
        sent.append(given)
        return real(*given)

    monkeypatch.setattr(centre._fs, "put_file", pulled)
    with pytest.raises(CentreError, match=r"Network is unreachable.*1 folders were sent, nothing is lost"):
        send(centre, ledger)
    assert outbox(None, ledger, centre.url).waiting == ["U-1/20261103T000000Z_ramp"]
    monkeypatch.setattr(centre._fs, "put_file", real)
    assert send(centre, ledger).sent == ["U-1/20261103T000000Z_ramp"]
    assert outbox(centre, ledger, centre.url).waiting == []


def test_a_file_that_is_not_what_was_recorded_is_not_sent(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1", "U-2"), centre_at(tmp_path)
    damaged = ledger.root / "U-1" / "20261101T000000Z_ramp" / "data.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"!")
    done = send(centre, ledger)
    assert done.sent == ["U-2/20261101T000000Z_ramp"]
    assert str(damaged) in done.damaged[0]
    damaged.unlink()
    assert "is missing" in send(centre, ledger).damaged[0]


def test_runs_that_go_on_or_were_killed_are_not_sent(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1", "U-2"), centre_at(tmp_path)
    (ledger.root / "U-1" / "20261101T000000Z_ramp" / "live.json").write_text(json.dumps({"pid": os.getpid()}))
    (ledger.root / "U-2" / "killed" / "journal").mkdir(parents=True)
    done = send(centre, ledger)
    assert done.sent == ["U-2/20261101T000000Z_ramp"]
    assert done.unfinished == [ledger.root / "U-2" / "killed"]


def test_a_cloned_disk_is_refused_and_with_an_id_of_its_own_sends_only_what_is_new(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path)
    send(centre, ledger)
    shutil.copytree(ledger.root, tmp_path / "b")
    clone = archive(tmp_path / "b")
    record(clone, "U-9", "20261102T000000Z_ramp", 1)
    with pytest.raises(InputError, match=r"sends from .*/a .*--copied.*--moved"):
        send(centre, clone)
    assert send(centre, clone.renewed()).sent == ["U-9/20261102T000000Z_ramp"]
    here = archive(tmp_path / "here")
    fetch(centre, here)
    assert manifests(here.root) == manifests(clone.root)


def test_a_clone_that_looks_like_the_same_computer_is_known_by_its_ledger(tmp_path, monkeypatch):
    ledger, centre = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path)
    shutil.copytree(ledger.root, tmp_path / "b")
    record(ledger, "U-2", "20261102T000000Z_ramp", 1)
    send(centre, ledger)
    clone = archive(tmp_path / "b")
    record(clone, "U-3", "20261103T000000Z_ramp", 2)
    monkeypatch.setattr(type(clone), "place", ledger.place)
    with pytest.raises(InputError, match="goes on otherwise"):
        send(centre, clone)
    assert send(centre, ledger).sent == []  # the other one is not harmed


def test_another_computer_has_another_name_though_its_disk_is_a_copy(tmp_path):
    (tmp_path / "machine-id").write_text("same")
    for name, address in (("one", "02:00:00:00:00:01"), ("two", "02:00:00:00:00:02")):
        card = tmp_path / name / "eth0"
        (card / "device").mkdir(parents=True)
        (card / "address").write_text(address)
    one, two = (claiming.computer(tmp_path / "machine-id", tmp_path / name) for name in ("one", "two"))
    assert one != two
    (tmp_path / "one" / "can_usb").mkdir()  # a card without a device, such as a bridge
    assert claiming.computer(tmp_path / "machine-id", tmp_path / "one") == one


def test_a_moved_archive_says_so(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path)
    send(centre, ledger)
    ledger.root.rename(tmp_path / "b")
    moved = archive(tmp_path / "b")
    with pytest.raises(InputError, match="--moved"):
        send(centre, moved)
    assert send(centre, moved, moved=True).sent == []
    assert send(centre, moved).sent == []


def test_two_benches_with_a_run_of_the_same_name_keep_both(tmp_path):
    centre, here = centre_at(tmp_path), archive(tmp_path / "here")
    made = [bench_of(tmp_path / name) for name in ("a", "b")]
    for seed, ledger in enumerate(made):
        record(ledger, "SIM-0001", "20261101T000000Z_ramp", seed)
        send(centre, ledger)
    fetch(centre, here)
    assert manifests(here.root) == sorted(digest for ledger in made for digest in manifests(ledger.root))
    assert fetch(centre, here).folders == []
    assert len(list((here.root / "SIM-0001").iterdir())) == 2


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_the_registry_of_fetched_runs_is_that_of_the_benches(tmp_path, kind, request):
    centre, here = centre_at(tmp_path), archive(tmp_path / "here")
    for name, unit in (("a", "U-1"), ("b", "U-2")):
        ledger = bench_of(tmp_path / name, unit)
        ledger.append({"kind": "lot", "lot": f"lot-{name}", "units": [unit]})
        send(centre, ledger)
    where = str(here.root / "registry.sqlite") if kind == "sqlite" else request.getfixturevalue("postgres_url")
    for _ in range(2):  # nothing is heard twice
        folders = fetch(centre, here).folders
        with open_registry(where) as registry:
            assert register_all(registry, [RunFolder(folder) for folder in folders], here) == []
    assert len([line for line in here.entries() if line["kind"] == "lot"]) == 2
    from bench.archive import rebuild, runs, show

    with open_registry(where) as registry:
        assert rebuild(registry, here, only_compare=True).differences == ()
        assert [run["unit"] for run in runs(registry, archive=here.id)] == ["U-1", "U-2"]
        assert show(registry, "U-2")["unit"]["lot"] == "lot-b"


@pytest.fixture
def postgres_url():
    import uuid

    from tests.support.databases import binaries, database, postgres

    programs = binaries()
    if programs is None:
        pytest.skip("PostgreSQL is not installed")
    with postgres(programs) as server:
        yield database(server, f"bench_{uuid.uuid4().hex}")


def test_runs_of_several_benches_are_in_the_order_of_their_days(tmp_path):
    centre, here = centre_at(tmp_path), tmp_path / "here"
    early, late = bench_of(tmp_path / "a"), bench_of(tmp_path / "b")
    record(late, "U-1", "20261103T000000Z_ramp", 2)
    record(early, "U-1", "20261101T000000Z_ramp", 0)
    for ledger in (late, early):  # the bench that was offline comes last
        send(centre, ledger)
        sync_fetch(centre.url, (), here)
    from bench.archive import runs

    with open_registry(here / "registry.sqlite") as registry:
        assert [run["created"][:10] for run in runs(registry)] == ["2026-11-03", "2026-11-01"]


def test_runs_of_a_fetch_that_was_killed_come_into_the_registry_with_the_next_one(tmp_path):
    centre, here = centre_at(tmp_path), tmp_path / "here"
    send(centre, bench_of(tmp_path / "a", "U-1", "U-2"))
    assert len(fetch(centre, archive(here)).folders) == 2  # killed before they were registered
    sync_fetch(centre.url, (), here)
    from bench.archive import runs

    with open_registry(here / "registry.sqlite") as registry:
        assert [run["unit"] for run in runs(registry)] == ["U-1", "U-2"]


def test_a_newer_version_of_a_run_comes_into_the_registry_although_its_fetch_was_killed(tmp_path):
    from bench.archive import runs

    ledger, centre, here = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path), tmp_path / "here"
    send(centre, ledger)
    sync_fetch(centre.url, (), here)
    keep(ledger.root / "U-1" / "20261101T000000Z_ramp", "calibration.json", {"verdict": {"verdict": "adequate"}})
    send(centre, ledger)
    assert len(fetch(centre, archive(here)).folders) == 1  # killed before it was registered
    for _ in range(2):
        done = sync_fetch(centre.url, (), here).done
        with open_registry(here / "registry.sqlite") as registry:
            assert [run["verdict"] for run in runs(registry)] == ["adequate"]
    assert done.unregistered == []


def test_what_was_written_into_a_fetched_folder_stays_until_somebody_says_otherwise(tmp_path):
    ledger, centre, here = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path), archive(tmp_path / "here")
    send(centre, ledger)
    (folder,) = fetch(centre, here).folders
    put(folder, {"mine.json": b"{}"})
    assert fetch(centre, here).kept == []  # nothing newer is there
    put(ledger.root / "U-1" / folder.name, {"theirs.json": b"{}"})
    send(centre, ledger)
    assert fetch(centre, here).kept == [folder]
    assert (folder / "mine.json").exists()
    assert fetch(centre, here, replace=True).folders == [folder]
    assert (folder / "theirs.json").exists()
    assert send(centre_at(tmp_path), here).sent == []  # and it is not sent a second time


def test_raw_data_leave_the_bench_once_the_centre_has_proven_them_and_come_back(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1", times=2), centre_at(tmp_path)
    old, young = (ledger.root / "U-1" / f"2026110{day}T000000Z_ramp" for day in (1, 2))
    before = contents(old)
    now = datetime(2026, 11, 11, 12, tzinfo=UTC)
    assert "is not at the centre yet" in release(centre, ledger, 10.0, now).refused[0]
    send(centre, ledger)
    done = release(centre, ledger, 10.0, now)
    assert done.folders == [old]
    assert done.bytes > 0
    assert (young / "data.parquet").exists()
    assert list(faults(old)) == []
    assert scrub(centre).faults == []
    assert send(centre, ledger).sent == [f"U-1/{old.name}"]  # the note that they are elsewhere
    assert bring_back(centre, old) == 1
    assert {name: digest for name, digest in contents(old).items() if name in before and name != "chain.seal"} == {
        name: digest for name, digest in before.items() if name != "chain.seal"
    }
    prove(old)


def test_raw_data_that_the_centre_has_damaged_stay_at_the_bench(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path)
    send(centre, ledger)
    raw = ledger.root / "U-1" / "20261101T000000Z_ramp" / "data.parquet"
    spoil(tmp_path, raw)
    assert "is damaged" in release(centre, ledger, 0.0).refused[0]
    assert raw.exists()


def spoil(tmp_path, file):
    place = tmp_path / "centre" / "files" / sha256(file)[:2] / sha256(file)
    data = bytearray(place.read_bytes())
    data[len(data) // 2] ^= 1
    place.unlink()
    place.write_bytes(data)
    return place


def test_a_scrub_names_what_is_damaged_and_missing_and_the_bench_sends_it_again(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1", times=2), centre_at(tmp_path)
    send(centre, ledger)
    one, two = (ledger.root / "U-1" / f"2026110{day}T000000Z_ramp" for day in (1, 2))
    damaged, missing = spoil(tmp_path, one / "means.parquet"), sha256(two / "data.parquet")
    (tmp_path / "centre" / "files" / missing[:2] / missing).unlink()
    found = scrub(centre).faults
    assert len(found) == 2
    assert damaged.name in found[0]
    assert "is damaged" in found[0]
    assert missing in found[1]
    assert "is missing" in found[1]
    here = archive(tmp_path / "here")
    assert len(fetch(centre, here, large=True).damaged) == 2
    assert scrub(centre, repair=True).aside == 2
    assert len(send(centre, ledger).sent) == 2
    assert scrub(centre).faults == []
    assert len(fetch(centre, here, large=True).folders) == 2


def test_an_altered_entry_is_told(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path)
    send(centre, ledger)
    (name,) = newest(centre).values()
    content = json.loads(centre.read(name.path))
    content["files"]["means.parquet"]["sha256"] = "0" * 64
    centre.write(name.path, json.dumps(content).encode())
    assert "does not fit its name" in scrub(centre).faults[0]


def test_an_entry_that_names_a_file_outside_its_folder_is_refused(tmp_path):
    ledger, centre = bench_of(tmp_path / "a", "U-1"), centre_at(tmp_path)
    send(centre, ledger)
    (name,) = newest(centre).values()
    known = read(centre, name)
    file = next(iter(known.files.values()))
    evil = EntryRecord(**{**known.content(), "number": 2, "files": {"../../evil": file.content()}})
    from bench.archive.centre.entries import Name

    centre.write(Name.of(evil).path, evil.text().encode())
    assert "outside its folder" in fetch(centre, archive(tmp_path / "here")).damaged[0]
    assert not list(tmp_path.rglob("evil"))


def test_a_place_that_is_no_centre_is_not_written_to(tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("x")
    for begin, said in ((False, "is no centre"), (True, "holds other files")):
        with pytest.raises(InputError, match=said):
            Centre(str(tmp_path / "other"), begin=begin)
    with pytest.raises(InputError, match="no such kind of place"):
        Centre("gopher://somewhere/x")


def test_a_password_is_never_printed():
    from bench.archive.centre import store

    assert store.named("sftp://me:secret@host:22/runs") == "sftp://me@host:22/runs"


def test_a_bench_that_was_killed_while_it_made_the_centre_makes_it_the_next_time(tmp_path):
    (tmp_path / "centre" / "tmp").mkdir(parents=True)
    (tmp_path / "centre" / "tmp" / "begun").write_text("x")
    assert centre_at(tmp_path).has("centre.json")


def test_a_centre_that_is_not_mounted_is_not_made_anew_in_the_empty_folder(tmp_path):
    ledger, url = bench_of(tmp_path / "a", "U-1"), str(tmp_path / "centre")
    send(reached(url, ledger), ledger)
    (tmp_path / "centre").rename(tmp_path / "unmounted")
    (tmp_path / "centre").mkdir()
    with pytest.raises(CentreError, match="1 folders were sent there before: is it mounted"):
        reached(url, ledger)
    assert not list((tmp_path / "centre").iterdir())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_centre_on_s3(tmp_path, monkeypatch):
    for key in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(key, "test")
    with s3() as (endpoint, end):
        monkeypatch.setenv("AWS_ENDPOINT_URL", endpoint)
        ledger, here = bench_of(tmp_path / "a", "U-1"), archive(tmp_path / "here")
        centre = Centre("s3://line/runs", begin=True)
        assert send(centre, ledger).sent == ["U-1/20261101T000000Z_ramp"]
        assert send(centre, ledger).sent == []
        assert scrub(centre).faults == []
        (folder,) = fetch(centre, here, large=True).folders
        assert contents(folder) == contents(ledger.root / "U-1" / folder.name)
        record(ledger, "U-1", "20261102T000000Z_ramp", 1)
        assert outbox(centre, ledger, centre.url).waiting == ["U-1/20261102T000000Z_ramp"]
        end()
        with pytest.raises(CentreError):
            send(centre, ledger)
    assert outbox(None, ledger, centre.url).waiting == ["U-1/20261102T000000Z_ramp"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_centre_on_sftp(tmp_path, monkeypatch):
    (tmp_path / "served").mkdir()
    with sftp(tmp_path / "served") as url:
        ledger, here = bench_of(tmp_path / "a", "U-1"), archive(tmp_path / "here")
        centre = Centre(url, begin=True)
        assert send(centre, ledger).sent == ["U-1/20261101T000000Z_ramp"]
        assert send(centre, ledger).sent == []
        assert scrub(centre).faults == []
        (folder,) = fetch(centre, here, large=True).folders
        assert contents(folder) == contents(ledger.root / "U-1" / folder.name)


def test_every_command_that_reads_runs_reads_those_of_a_centre(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from bench.cli import main

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    ledger, centre = archive(tmp_path / "a"), centre_at(tmp_path)
    folder = ledger.root / "U-1" / "r1"
    make_run(folder, **ramp_run(), unit="U-1", run="r1", created="2026-11-01T00:00:00+00:00")
    send(centre, ledger)

    def bench(*arguments):
        said = CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)
        assert said.exit_code == 0, said.output
        return json.loads(said.stdout)

    run = f"{ledger.id}/U-1/r1"
    listed = bench("registry", "list", "--out", centre.url, "--json")["runs"]
    assert [row["path"] for row in listed] == ["U-1/r1"]
    own = bench("compare", folder, "--model", "polynomial", "--json")
    assert bench("compare", f"{centre.url}#{run}", "--model", "polynomial", "--json")["models"] == own["models"]
    monkeypatch.setenv("BENCH_CENTRE", centre.url)
    assert bench("diagnose", run, "--model", "polynomial", "--json")["verdict"]
    assert archive_of_centre(centre.url).is_relative_to(tmp_path / "cache")
    unknown = CliRunner().invoke(main, ["diagnose", f"{ledger.id}/U-9/r1", "--model", "polynomial"])
    assert (unknown.exit_code, unknown.stderr.count("\n")) == (2, 1)


def test_two_benches_that_begin_a_centre_at_the_same_moment_both_have_it(tmp_path):
    class Later(Centre):
        looked = False

        def has(self, name):
            """At the first look the centre is not there yet."""
            first, self.looked = not self.looked, True
            return not first and super().has(name)

    url = str(tmp_path / "centre")
    send(Centre(url, begin=True), bench_of(tmp_path / "a", "U-1"))
    other = bench_of(tmp_path / "b", "U-2")
    assert send(Later(url, begin=True), other).sent == ["U-2/20261101T000000Z_ramp"]
