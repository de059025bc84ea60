"""Files of others are read within limits: memory that follows the file and the machine, and one line where it ends."""

import subprocess
import sys

import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import bench as bench_package
from bench.acquisition.importer import confines
from bench.acquisition.importer.confines import FOR_A_RUN, FOR_EACH_BYTE, LEAST_BYTES, Confines, memory_for
from bench.acquisition.importer.reading import read_confined
from bench.acquisition.importer.tables import read_table
from bench.base import InputError
from tests.support.commands import bench

MEMORY = 700 * 10**6
"""Twice what the programs take that read."""
HEADER = b"time,rate,temperature\n"
ROW = b"1,2.5,25.0\n"


def refused(path, **limits):
    with pytest.raises(InputError) as error:
        read_confined(path, None, Confines(**{"memory_bytes": MEMORY, **limits}))
    assert "\n" not in str(error.value)
    return str(error.value)


def mf4(path, rows, columns):
    from asammdf import MDF, Signal

    with MDF() as file:
        signals = [Signal(np.zeros(rows), np.arange(rows) / 500.0, name=f"s{i}") for i in range(columns)]
        file.append(signals)
        file.save(path, compression=2)


@pytest.mark.slow
def test_an_open_quote_takes_no_memory_and_is_named_with_its_line(tmp_path):
    path = tmp_path / "quote.csv"
    path.write_bytes(HEADER + ROW * 5 + b'6,"2.5,25.0\n' + ROW * 1_500_000)
    assert f"{path}:7: a quoted field has no end" in refused(path)


@pytest.mark.slow
def test_comments_do_not_multiply_the_memory(tmp_path):
    path = tmp_path / "comments.csv"
    path.write_bytes(HEADER + b"# a\n" + b"".join(b"%d,2.5,25.0\n" % i for i in range(1_000_000)))
    table = read_confined(path, None, Confines(memory_bytes=MEMORY))
    assert table.rows == 1_000_000
    assert table.line(0) == 3
    assert table.line(999_999) == 1_000_002


def test_a_parquet_file_of_very_many_columns_is_refused_by_what_it_says_of_itself(tmp_path):
    path = tmp_path / "wide.parquet"
    pq.write_table(pa.table({f"c{i}": [1.0] for i in range(5000)}), path)
    assert "has 5,000 columns, allowed are 2,000" in refused(path)


@pytest.mark.slow
def test_an_mf4_file_that_unpacks_to_too_much_is_refused_by_what_it_says_of_itself(tmp_path):
    path = tmp_path / "bomb.mf4"
    mf4(path, 1_000_000, 40)
    assert path.stat().st_size < 10_000_000
    assert "unpacked" in refused(path)
    with pytest.raises(InputError, match="unpacked"):
        read_table(path, None, MEMORY)  # a program that reads without a process of its own


def test_what_was_read_in_the_other_process_is_what_is_read_in_this_one(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"time [s],rate [deg/h],temperature\n\n0,1.5,25\n1,,26\n# x\n2,2.25,27")
    ours, theirs = read_table(path), read_confined(path)
    assert list(ours.columns) == list(theirs.columns)
    for name, values in ours.columns.items():
        np.testing.assert_array_equal(values, theirs.columns[name])
    assert [ours.line(i) for i in range(3)] == [theirs.line(i) for i in range(3)] == [3, 4, 6]
    assert ours.notes == theirs.notes
    assert ours.units == theirs.units


def test_the_other_process_imports_from_where_this_one_does(tmp_path, monkeypatch):
    (tmp_path / "own_reader.py").write_text(
        "import sys\nfrom pathlib import Path\nimport bench\nfrom bench.acquisition import answering\n"
        "answering(lambda wanted: {'bench': bench.__file__}, Path(sys.argv[1]), Path(sys.argv[2]))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    (folder := tmp_path / "asked").mkdir()
    limits = Confines(memory_bytes=MEMORY)
    assert confines.run_confined("own_reader", {}, folder, limits, folder) == {"bench": bench_package.__file__}


def test_the_limit_follows_the_file_and_the_memory_that_is_free(monkeypatch):
    monkeypatch.setattr(confines, "free_bytes", lambda: 100 * 10**9)
    assert memory_for(1000) == LEAST_BYTES
    assert memory_for(10**9) == FOR_EACH_BYTE * 10**9
    monkeypatch.setattr(confines, "free_bytes", lambda: FOR_A_RUN + 10**9)
    assert memory_for(10**9) == 5 * 10**8
    monkeypatch.setattr(confines, "free_bytes", lambda: 0)
    assert 0 < memory_for(10**9) < LEAST_BYTES


def test_a_small_file_cannot_keep_a_reader_busy_for_long():
    assert confines.processor_s_for(20_000) < 10
    assert confines.processor_s_for(1 << 30) > 3600


def test_the_free_memory_is_known_here():
    assert 0 < confines.free_bytes() < 1 << 50


@pytest.mark.slow
def test_the_command_says_it_in_one_line_and_more_memory_may_be_allowed(tmp_path):
    path = tmp_path / "x.parquet"
    rows = 8_000_000
    columns = {name: pa.array(np.zeros(rows)) for name in ("rate", "temperature")}
    pq.write_table(pa.table({**columns, "time": pa.array(np.arange(rows, dtype=np.uint32))}), path, row_group_size=rows)
    tight = bench("import", path, "--preview", "--memory", "0.5")
    assert tight.exit_code == 2
    assert tight.stderr.count("\n") == 1
    assert "--memory GB" in tight.stderr
    assert bench("import", path, "--preview", "--memory", "3").exit_code == 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere an alarm ends it")
def test_a_reader_ends_with_the_command_that_was_killed(tmp_path):
    path = tmp_path / "pipe.csv"
    path.write_bytes(HEADER + b"#\n1,2,x\n" * 20_000_000)
    code = f"from bench.cli import main; main(['import', {str(path)!r}, '--preview'])"
    parent = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    found = None
    while parent.poll() is None and found is None:
        found = next((child for child in psutil.Process(parent.pid).children() if "-m" in child.cmdline()), None)
    assert found is not None
    while found.is_running() and found.cpu_times().user < 1.0:  # it has begun to read
        pass
    parent.kill()
    parent.wait()
    assert psutil.wait_procs([found], timeout=60)[0]
