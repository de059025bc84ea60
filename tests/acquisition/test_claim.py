"""Two benches at one chamber: the second is refused at once, however its station file writes the address."""

import os
import subprocess
import sys

import pytest

from bench.acquisition.station.claim import address, claimed
from bench.acquisition.station.settings.chamber import Connection
from bench.base import InputError

HERE = Connection(url="tcp://127.0.0.1:1502")
HOLD = """
import sys
from bench.acquisition.station.claim import claimed
from bench.acquisition.station.settings.chamber import Connection
with claimed(Connection(url="tcp://127.0.0.1:1502")):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


@pytest.mark.parametrize("url", ["tcp://localhost:1502", "rtu+tcp://127.0.0.1:1502"])
def test_a_chamber_that_another_process_uses_is_refused_with_its_number(url):
    with subprocess.Popen([sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        try:
            assert other.stdout.readline() == b"held\n"
            text = rf"is in use by process {other.pid}, or its watchdog; end that run first.*nothing was moved"
            with pytest.raises(InputError, match=text), claimed(Connection(url=url)):
                pass
            with claimed(Connection(url="tcp://127.0.0.1:1503")), claimed(Connection(url=HERE.url, device=2)):
                pass
        finally:
            other.kill()
    with claimed(HERE):  # the claim goes with its process
        pass


def test_whoever_was_given_the_claim_keeps_it():
    with claimed(HERE) as handle:
        watchdog = subprocess.Popen(["cat"], stdin=subprocess.PIPE, pass_fds=(handle,))
    with pytest.raises(InputError, match=f"in use by process {os.getpid()}, or its watchdog"), claimed(HERE):
        pass
    watchdog.communicate()
    with claimed(HERE):
        pass


def test_a_serial_line_is_one_address_by_any_name(tmp_path):
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "chamber").symlink_to(tmp_path / "ttyUSB0")
    names = {
        address(Connection(url=f"rtu://{tmp_path}/{name}", device=n)) for n, name in enumerate(("ttyUSB0", "chamber"))
    }
    assert len(names) == 1
