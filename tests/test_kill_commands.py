"""Commands that write, killed at a change of a file or at a moment: a sample of `benchmarks.kill_commands`."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow(first=True)
def test_what_a_killed_command_leaves_is_whole_when_it_is_given_again():
    words = ["--kills", "3", "--seed", "3", "--only", "calibrate", "--only", "page imports", "--only", "import"]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.kill_commands", *words],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert json.loads(done.stdout)["kills"] == 3
