"""What can be checked here of other operating systems: nothing of POSIX alone is needed to import, read and judge runs.

The program below takes away what Windows does not have, and then does what docs/systems.md says works there.
"""

import os
import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from bench.acquisition.run.runner import run_job
from bench.base.errors import InputError
from bench.record import create_run, slug
from tests.support import acquisition
from tests.support.run_folders import make_run, ramp_run

ROOT = Path(__file__).parent.parent
WITHOUT_POSIX = """
import builtins, os, signal, sys

# Libraries know where they are, and have other modules for Windows.
def as_on_windows(name, globals=None, locals=None, fromlist=(), level=0):
    ours = (globals or {}).get("__name__", "").partition(".")[0] in {"bench", "drivers"}
    if ours and name in {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp", "syslog"}:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return original(name, globals, locals, fromlist, level)

original, builtins.__import__ = builtins.__import__, as_on_windows
import multiprocessing.util, shutil, subprocess, socket, getpass, logging, ssl, serial
KEPT = {"SIGINT", "SIGTERM", "SIGABRT", "SIGFPE", "SIGILL", "SIGSEGV"}
for name in [name for name in dir(signal) if name.startswith("SIG") and name[3].isalpha() and name not in KEPT]:
    if not name.startswith("SIG_"):
        delattr(signal, name)
GONE = "fork forkpty killpg nice sysconf getuid geteuid openpty fchmod O_NOFOLLOW pread pwrite pidfd_open getpgid"
for name in (*GONE.split(), "setsid", "mkfifo", "sched_getaffinity", "posix_fadvise", "set_blocking"):
    if hasattr(os, name):
        delattr(os, name)
for name in ("setitimer", "pidfd_send_signal", "pthread_sigmask"):
    delattr(signal, name)
del signal.ITIMER_REAL
"""
IMPORT_ALL = (
    WITHOUT_POSIX
    + """
import importlib, pkgutil
import bench, drivers
failed = []
for package in (bench, drivers):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__") and "._profiles" not in module.name:
            try:
                importlib.import_module(module.name)
            except Exception as error:
                failed.append(f"{module.name}: {type(error).__name__}: {error}")
print("\\n".join(failed))
"""
)
COMMANDS = (
    WITHOUT_POSIX
    + """
from pathlib import Path
from click.testing import CliRunner
from bench.cli import main
place = Path(sys.argv[1])
def told(*words):
    answer = CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
told("import", place / "log.csv", "--unit", "G-1042", "--out", place / "reports")
(run,) = (place / "reports" / "G-1042").iterdir()
told("report", run, "--model", "polynomial")
told("export", run, "--format", "c", "--out", place / "c")
told("registry", "rebuild", "--out", place / "reports")
told("check", "profiles/quick.yaml")
"""
)


def python(program, *arguments):
    """What a program prints; it must end well."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program, *map(str, arguments)],
        cwd=ROOT, env={**os.environ, "LOGNAME": "a"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_every_module_is_imported_without_what_only_posix_has():
    assert python(IMPORT_ALL) == ""


@pytest.mark.slow
def test_a_log_is_imported_judged_and_exported_without_what_only_posix_has(tmp_path):
    time = 12.0 * np.arange(600)
    degc = np.interp(time / time[-1], [0, 0.25, 0.75, 1], [25, -30, 70, 25])
    rate = 30 + 0.8 * degc + np.random.default_rng(1).normal(0, 1, time.size)
    head = "time [s],rate [deg/h],temp [degC]"
    np.savetxt(tmp_path / "log.csv", np.column_stack([time, rate, degc]), "%.6f", ",", header=head, comments="")
    python(COMMANDS, tmp_path)
    assert (tmp_path / "c" / "calibration.c").is_file()


def refused_by_windows(name):
    stem = name.partition(".")[0].upper()
    reserved = re.fullmatch(r"CON|PRN|AUX|NUL|(COM|LPT)\d", stem) is not None
    return reserved or bool(re.search(r'[<>:"/\\|?*\x00-\x1f]|[. ]$', name))


def test_no_run_has_a_name_that_windows_refuses(tmp_path):
    content = acquisition.station_content()
    unit = {**content["units"][0], "serial": 'a:b/c?"1'}
    settings = acquisition.station(units=[unit])
    run = run_job(
        acquisition.job(tmp_path, acquisition.SHORT.replace("name: short", "name: 'con: <soak>|'"), settings)
    ).run
    names = [part for path in tmp_path.rglob("*") for part in path.relative_to(tmp_path).parts]
    assert len(names) > 10
    assert not [name for name in names if refused_by_windows(name)]
    assert run.manifest().unit == 'a:b/c?"1'


@pytest.mark.parametrize("name", ["CON", "nul", "com1.csv", "Aux", "lpt9", "a.", " b ", "x:y"])
def test_a_name_in_a_path_is_one_that_windows_takes(name):
    assert refused_by_windows(name) or name == " b "
    assert not refused_by_windows(slug(name))


def test_units_have_folders_of_their_own_in_any_script(tmp_path):
    created = datetime(2026, 1, 2, tzinfo=UTC)
    serials = ["GX-Ж-1", "GX-Я-1", "陀螺", "陀螺仪"]
    assert [create_run(tmp_path, one, "ramp", created).path.parent.name for one in serials] == serials


def test_a_unit_gets_no_folder_of_another(tmp_path):
    make_run(tmp_path / "A-1" / "r1", **ramp_run(), unit="A/1", run="r1")
    created = datetime(2026, 1, 2, tzinfo=UTC)
    with pytest.raises(InputError, match="unit A:1 would share this folder with unit A/1"):
        create_run(tmp_path, "A:1", "ramp", created)
    assert [path.name for path in (tmp_path / "A-1").iterdir()] == ["r1"]
    assert create_run(tmp_path, "A/1", "ramp", created).path.parent.name == "A-1"


@pytest.mark.parametrize("name", ["bench", "Bench", "a/b", "c:1", "nul"])
def test_a_bus_has_a_name_that_can_be_that_of_its_journal(name):
    content = acquisition.station_content()
    units = [{**unit, "bus": name} for unit in content["units"]]
    with pytest.raises(InputError) as refused:
        acquisition.station(buses={name: content["buses"]["can0"]}, units=units)
    assert "name of a bus" in str(refused.value)


def test_a_real_chamber_is_refused_where_nothing_can_claim_it(tmp_path):
    program = WITHOUT_POSIX + (
        "from bench.acquisition.station.claim import claimed\n"
        "from bench.acquisition.station.settings.chamber import Connection\n"
        "try:\n    with claimed(Connection(url='tcp://127.0.0.1:1')): pass\n"
        "except Exception as error:\n    print(type(error).__name__, error)\n"
    )
    assert python(program).startswith("InputError this system has no locks by which a chamber is claimed")


def test_a_page_says_what_is_known_of_each_system():
    page = (ROOT / "docs" / "systems.md").read_text(encoding="utf-8")
    assert "| | Linux | macOS | Windows |" in page.splitlines()
