"""What a process of the bench does not import until it is needed."""

import subprocess
import sys

import pytest

SCRIPT = """
import sys
import drivers.canbus, can
print("asammdf" in sys.modules, "sympy" in sys.modules)
with can.Logger("frames.mf4") as log:
    log.on_message_received(can.Message(timestamp=1.5, arbitration_id=0x120, data=b"abc", is_extended_id=False))
with can.LogReader("frames.mf4") as log:
    print([(frame.arbitration_id, bytes(frame.data)) for frame in log], "asammdf" in sys.modules)
"""


def test_mf4_is_imported_by_who_reads_or_writes_such_a_log(tmp_path):
    command = [sys.executable, "-W", "ignore", "-c", SCRIPT]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert said.splitlines() == ["False False", "[(288, b'abc')] True"]


@pytest.mark.parametrize("part", ["app", "routes"])
def test_the_page_and_its_api_begin_without_what_only_computations_import(part):
    wanted = "scipy.special", "scipy.optimize", "scipy.interpolate", "scipy.linalg", "scipy.sparse", "aiohttp", "pandas"
    script = f"import sys, bench.web.server.{part}; print([name for name in {wanted} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"


def test_a_list_of_effects_is_printed_without_the_bench_that_runs():
    wanted = "serial", "threadpoolctl", "scipy.optimize", "scipy.interpolate", "pandas", "matplotlib"
    script = (
        "import atexit, sys; from bench.cli import main\n"
        f"atexit.register(lambda: print([name for name in {wanted} if name in sys.modules], file=sys.stderr))\n"
        "main(['effects', '--json'])"
    )
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stderr
    assert said.strip() == "[]"
