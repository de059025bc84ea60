"""A bench that stood still, or a computer that slept, leaves an event; a killed one leaves nothing once recovered."""

import shutil

import pytest

from bench.acquisition.run.remote import LiveFile
from bench.acquisition.run.runner import run_job
from bench.acquisition.run.standstill import Standstill
from bench.commands.analysis import recover
from tests.support import acquisition


@pytest.mark.parametrize(
    ("bench_s", "calendar_s", "said"),
    [
        (1.0, 1.0, None),
        (4.0, 4.5, None),
        (41.0, 41.0, "stood still for 41 s"),
        (1.0, 41.0, "calendar clock went ahead by 40 s: the computer was suspended"),
        (1.0, -3600.0, None),
    ],
)
def test_time_that_nobody_watched_is_told(bench_s, calendar_s, said):
    events = []
    standstill = Standstill(lambda kind, text, **facts: events.append((kind, text)))
    standstill.tick(100.0, 5000.0)
    assert events == []
    standstill.tick(100.0 + bench_s, 5000.0 + calendar_s)
    assert (events[0][0] if events else None) == (None if said is None else "standstill")
    assert said is None or said in events[0][1]


@pytest.mark.slow
def test_what_a_killed_bench_left_beside_its_journals_goes_with_its_recovery(tmp_path):
    run = run_job(acquisition.job(tmp_path / "out")).run
    killed = tmp_path / "killed" / "SIM-0001" / run.path.name
    shutil.copytree(run.path, killed)
    for name in ("manifest.json", "data.parquet", "means.parquet"):
        (killed / name).unlink()
    LiveFile(pid=1, port=9, start="2026-01-01T00:00:00+00:00", journals=[], token="x" * 20).write(killed)
    for name in (".manifest.json.a1b2c3d4", ".can0.gtbj.part", ".hidden", "notes.txt"):
        (killed / name).write_text("half")
    recover(killed)
    left = {path.name for path in killed.iterdir()} - {path.name for path in run.path.iterdir()}
    assert left == {".hidden", "notes.txt"}
