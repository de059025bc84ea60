"""A bench that is killed when its profile is over, but nothing is made of the record yet."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import bench

KILLED = """
import os, sys
from pathlib import Path
import bench.acquisition.run.runner as runner
from tests.support import acquisition
runner.assemble = lambda *_: os._exit(9)
runner.run_job(acquisition.job(Path(sys.argv[1])))
"""


@pytest.mark.slow
@pytest.mark.parametrize("command", ["resume", "report"])
def test_the_run_is_recovered_analysed_and_registered(tmp_path, command):
    root = str(Path(__file__).parents[2])
    words = [sys.executable, "-c", KILLED, str(tmp_path)]
    done = subprocess.run(words, env={**os.environ, "PYTHONPATH": root}, capture_output=True, text=True, check=False)
    assert done.returncode == 9, done.stderr
    (run,) = tmp_path.glob("*/*_short")
    said = bench(command, run)
    assert said.exit_code in {0, 1}, said.output
    assert {"manifest.json", "calibration.json", "report.html"} <= {path.name for path in run.iterdir()}
    listed = bench("registry", "list", "--out", tmp_path)
    assert run.name in listed.output
