"""Units whose coefficients go by a protocol of their own: a program of the user, named in the station file."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from bench.acquisition.station.simulation import eeprom_file
from bench.cli import main
from bench.commands.acquisition import load_station
from bench.commands.flash_record import newest_record, records
from bench.deliver.export.image import read
from bench.deliver.export.words import to_words
from bench.record import Manifest, RunFolder
from bench.record.reading import load
from tests.support import acquisition, flash_bench

ROOT = Path(__file__).parents[2]
TOOL = '''
"""A unit's own protocol, as its maker's tool speaks it: the memory is a file beside the tool."""
import pathlib, sys
here = pathlib.Path(__file__).parent
what, serial = sys.argv[1:3]
memory = here / f"{serial}.memory"
with open(here / "calls.txt", "a") as calls:
    print(*sys.argv[1:], file=calls)
if what == "write":
    memory.write_bytes(pathlib.Path(sys.argv[3]).read_bytes() if len(sys.argv) > 3 else sys.stdin.buffer.read())
if what in ("write", "read") and memory.exists():
    sys.stdout.buffer.write(memory.read_bytes())
'''


class Unit:
    """A station in a folder of its own with one unit that is flashed by a command."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "reports"
        folder.mkdir()
        self.tool(TOOL)
        self.describe()

    def tool(self, text: str) -> None:
        (self.folder / "tool.py").write_text(text)

    def argv(self, *words: str) -> list[str]:
        return [sys.executable, "tool.py", *words]

    def describe(self, changes: dict | None = None, gyro: str = "vibratory", **flash) -> None:
        """Write the station file; the paths of the commands are relative to it."""
        way = {
            "protocol": "command",
            "write": self.argv("write", "{serial}", "{image}"),
            "read": self.argv("read", "{serial}"),
            "compensate": self.argv("compensate", "{serial}", "{state}"),
            **flash,
        }
        unit = {"serial": "SIM-0001", "bus": "can0", "number": 0, "identity": 1, "gyro": gyro, "flash": way}
        content = acquisition.station_content(units=[unit], **(changes or {}))
        (self.folder / "station.yaml").write_text(json.dumps(content))

    def image(self, number: int = 1, **wishes) -> Path:
        path = self.folder / f"{number}.bin"
        path.write_bytes(flash_bench.image(**{"serial": 1, "id_": number, "shift_dps": 0.01 * number} | wishes))
        return path

    def bench(self, command: str, *words: object) -> Result:
        given = [command, *words, "--station", self.folder / "station.yaml", "--out", self.out, "--quiet"]
        return CliRunner().invoke(main, [str(word) for word in given], catch_exceptions=False)

    def refused(self, code: int, *words: object) -> str:
        done = self.bench(*words)
        assert (done.exit_code, done.stderr.count("\n")) == (code, 1), done.output
        return done.stderr

    @property
    def calls(self) -> list[str]:
        return (self.folder / "calls.txt").read_text().splitlines()

    @property
    def attempts(self) -> list:
        return list(records(self.out / "SIM-0001" / "flash"))


@pytest.fixture
def unit(tmp_path: Path) -> Unit:
    return Unit(tmp_path / "bench")


@pytest.mark.parametrize("by", ["file", "standard input"])
def test_a_command_gets_the_image_and_answers_with_what_it_read_back(unit: Unit, by: str) -> None:
    if by == "standard input":
        unit.describe(write=unit.argv("write", "{serial}"))
    done = unit.bench("flash", "SIM-0001", "--image", unit.image(1))
    assert done.exit_code == 0, done.output
    assert "in force, before: none\nread back and compared word by word\nrecord " in done.stdout
    assert (unit.folder / "SIM-0001.memory").read_bytes() == unit.image(1).read_bytes()
    assert [call.split()[0] for call in unit.calls] == ["read", "write", "read"]
    first = newest_record(unit.out, "SIM-0001")
    assert (first.protocol, first.state, first.bank, first.coefficient_set) == ("command", "done", None, None)
    assert first.read_back == "all words equal, after the write and again"
    assert unit.bench("flash", "SIM-0001", "--image", unit.image(2)).exit_code == 0
    second = newest_record(unit.out, "SIM-0001")
    assert second.old.sha256 == first.new.sha256
    assert (unit.out / "SIM-0001" / "flash" / second.old.file).read_bytes() == unit.image(1).read_bytes()
    again = unit.bench("flash", "SIM-0001", "--image", unit.image(2))
    assert "is already in force; nothing was written" in again.stdout


FAILURES = {
    "exit code": (
        "import sys; sys.exit('trace\\n\\n  no answer from the unit ')",
        4,
        "step 'archive' failed: unit SIM-0001: command * ended with exit code 1: no answer from the unit; nothing was",
    ),
    "silent exit": ("import sys; sys.exit(7)", 4, "* ended with exit code 7, without a word on its standard error; "),
    "signal": ("import os; os.kill(os.getpid(), 9)", 4, "* was ended by signal 9, without a word"),
    "time": (
        "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(600)'])",
        4,
        "* did not end within 0.1 s; nothing was written",
    ),
    "too much": ("import sys; sys.stdout.buffer.write(bytes(1_000_001))", 4, "* printed more than 1000000 bytes"),
}


@pytest.mark.parametrize("what", FAILURES)
def test_a_command_that_fails_is_one_line_and_a_record(unit: Unit, what: str) -> None:
    text, code, sentence = FAILURES[what]
    if what == "time":
        unit.describe(timeout_s=0.1)
    unit.tool(text)
    said = unit.refused(code, "flash", "SIM-0001", "--image", unit.image())
    assert_like(said, sentence)
    assert [(one.state, one.protocol) for one in unit.attempts] == [("failed", "command")]
    assert unit.attempts[0].error in said


WRONG = {
    "one word": ("b = b[:40] + b'wxyz' + b[44:]", "word 10 reads back 0x7A797877, 0x* was written"),
    "short": ("b = b[:-4]", "* bytes read back, * were written"),
    "nothing": ("b = b''", "0 bytes read back, * were written"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_read_back_is_one_line_and_a_record(unit: Unit, what: str) -> None:
    change, sentence = WRONG[what]
    text = TOOL.replace(
        "    sys.stdout.buffer.write(memory.read_bytes())",
        f"    b = memory.read_bytes()\n    if what == 'write':\n        {change}\n    sys.stdout.buffer.write(b)",
    )
    unit.tool(text)
    said = unit.refused(4, "flash", "SIM-0001", "--image", unit.image())
    assert_like(said, f"step 'write' failed: {sentence}; what the unit holds is not known: flash again")
    (attempt,) = unit.attempts
    assert (attempt.state, attempt.new.calibration_id) == ("failed", read(to_words(unit.image().read_bytes())).label)
    unit.tool(TOOL)  # it had written it all the same: the same command again reads it and completes the record
    assert "already in force" in unit.bench("flash", "SIM-0001", "--image", unit.image()).stdout
    assert [one.state for one in unit.attempts] == ["done"]


def test_a_command_that_forgets_after_the_write_is_found_by_the_second_reading(unit: Unit) -> None:
    unit.tool(TOOL + "\nif what == 'write': memory.unlink()\n")
    said = unit.refused(4, "flash", "SIM-0001", "--image", unit.image())
    assert_like(said, "step 'read again' failed: 0 bytes read back, * were written; what the unit holds is not known")


def test_an_image_for_another_unit_is_not_written(unit: Unit) -> None:
    said = unit.refused(2, "flash", "SIM-0001", "--image", unit.image(serial=2))
    assert_like(said, "unit SIM-0001: the image is for serial number 2, in the station file the unit is 1; nothing was")
    assert not (unit.folder / "calls.txt").exists()


def test_a_unit_behind_a_command_has_no_bank_to_go_back_to(unit: Unit) -> None:
    said = unit.refused(2, "flash", "SIM-0001", "--previous")
    assert_like(said, "is flashed by a command, which knows no banks; write an image that was kept * --older --image")


def mistakes(unit: Unit) -> dict[str, tuple[dict, str]]:
    return {
        "a shell string": ({"read": "tool read"}, 'flash.read is "tool read": must be a list'),
        "no read": ({"read": []}, "protocol command needs `read`, a list of a program and its arguments"),
        "a place": ({"read": unit.argv("{image}")}, "{image} is not known here; allowed: {serial}, {number}"),
        "no state": ({"compensate": unit.argv("off")}, "one argument must be {state}, for which `on` or `off` is put"),
        "not its protocol": ({"protocol": "uds"}, "a command needs `protocol: command`; this is uds"),
        "too long": ({"timeout_s": 60}, "timeout_s is 60: a bench that waits * ends it after silent_s, 60; make it"),
        "no program": ({"read": ["./missing"]}, "command ./missing cannot be started in * No such file or directory"),
    }


@pytest.mark.parametrize(
    "what", ["a shell string", "no read", "a place", "no state", "not its protocol", "too long", "no program"]
)
def test_mistakes_in_the_station_file_are_one_line(unit: Unit, what: str) -> None:
    changes, sentence = mistakes(unit)[what]
    unit.describe(**changes)
    said = CliRunner().invoke(
        main, ["flash", "SIM-0001", "--quiet", "--image", str(unit.image()), "--out", str(unit.out),
               "--station", str(unit.folder / "station.yaml")],
    )  # fmt: skip
    assert said.exit_code == 2, said.output
    assert_like(said.stderr, sentence)


def without_set(unit: Unit) -> str:
    """The DBC of the shipped family whose heartbeat does not tell the coefficient set."""
    text = (ROOT / "drivers" / "gyros" / "vibratory.dbc").read_text()
    kept = [line for line in text.splitlines() if "CoefficientSet" not in line]
    (unit.folder / "own.dbc").write_text("\n".join(kept))
    return "own.dbc"


def recorded(unit: Unit) -> list[RunFolder]:
    return [RunFolder(path.parent) for path in sorted((unit.out / "SIM-0001").glob("*/manifest.json"))]


SIMULATED = """
import pathlib, sys
sys.path.insert(0, {root!r})
from drivers.sim.eeprom import Eeprom
here = pathlib.Path(__file__).parent
with open(here / "calls.txt", "a") as calls:
    print(*sys.argv[1:], file=calls)
eeprom = Eeprom(pathlib.Path({path!r}))
if sys.argv[1] == "write":
    eeprom.erase(1)
    eeprom.put(1, 0, pathlib.Path(sys.argv[3]).read_bytes())
    eeprom.turn(1)
if sys.argv[1] != "compensate" and eeprom.switch[1]:
    sys.stdout.buffer.write(eeprom.image(1))
"""


def test_a_unit_whose_heartbeat_tells_no_set_is_flashed_and_verified(unit: Unit, short_run: RunFolder) -> None:
    """Its command writes what the simulated unit starts with, so that it corrects its rate in the verification."""
    profile = unit.folder / "short.yaml"
    profile.write_text(acquisition.SHORT)
    unit.describe({"eeproms": "memory"}, without_set(unit))
    settings = load_station(unit.folder / "station.yaml")
    unit.tool(SIMULATED.format(root=str(ROOT), path=str(eeprom_file(settings, settings.units[0]))))
    blank = unit.refused(2, "verify", profile, "--unit", "SIM-0001")
    assert_like(blank, "unit SIM-0001 holds no calibration; write one with `bench flash SIM-0001`")
    image = unit.image()
    assert unit.bench("flash", "SIM-0001", "--image", image).exit_code == 0
    done = unit.bench("verify", profile, "--unit", "SIM-0001")
    assert "INVALID" in done.stdout, done.output  # no soak of five minutes to read the noise from
    assert unit.calls[-1].split()[::2] == ["compensate", "on"]
    (corrected,) = recorded(unit)
    manifest = Manifest.read(corrected.path)
    assert (manifest.purpose, manifest.unit_identity.coefficient_set) == ("verification", None)
    stored = json.loads((corrected.path / "verification.json").read_text())
    assert stored["in_unit"]["calibration_id"] == read(to_words(image.read_bytes())).label
    shift = np.nanmean(load(short_run.path, 10.0).bias) - np.nanmean(load(corrected.path, 10.0).bias)
    assert shift == pytest.approx(3600 * 0.011, abs=1.0)  # what the image takes off near 25 degC


def test_a_calibration_run_has_the_correction_switched_off_and_on_again(unit: Unit) -> None:
    profile = unit.folder / "short.yaml"
    profile.write_text(acquisition.SHORT)
    unit.describe(gyro=without_set(unit))
    assert unit.bench("flash", "SIM-0001", "--image", unit.image()).exit_code == 0
    unit.bench("run", profile, "--unit", "SIM-0001")
    states = [call.split()[2] for call in unit.calls if call.startswith("compensate")]
    assert states == ["off", "on"]
    (run,) = recorded(unit)
    assert Manifest.read(run.path).purpose == "calibration"
    told = [event["text"] for event in run.events() if event["kind"] == "compensation"]
    assert told == [
        "unit SIM-0001 sends its raw rate for this run (its command has switched its calibration off)",
        "unit SIM-0001 corrects its rate again",
    ]


def test_a_unit_that_no_command_switches_is_not_calibrated_while_it_holds_a_calibration(unit: Unit) -> None:
    profile = unit.folder / "short.yaml"
    profile.write_text(acquisition.SHORT)
    unit.describe(gyro=without_set(unit), compensate=[])
    assert unit.bench("flash", "SIM-0001", "--image", unit.image()).exit_code == 0
    done = unit.bench("run", profile, "--unit", "SIM-0001")
    assert done.exit_code == 4
    assert_like(
        done.output,
        "unit SIM-0001 corrects its rate by the calibration that it holds and cannot be told to stop: "
        "its `flash` has no command `compensate`; see `flash` of the unit in the station file",
    )


def assert_like(said: str, sentence: str) -> None:
    """Whether the parts of a sentence stand in what was said, in this order; `*` is anything."""
    rest = said
    for part in filter(None, sentence.split("*")):
        _, found, rest = rest.partition(part)
        assert found == part, f"{part!r} is not in {said!r}"
