"""The pytest plugin, as projects use it that know nothing of the bench but its fixtures."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import can
import canopen
import pytest
import yaml
from pymodbus.client import ModbusTcpClient

pytest_plugins = ["bench.testing.plugin"]
PROJECT = Path(__file__).parent / "project"
PLUGIN = "bench.testing.plugin"
HEAVY = ("numpy", "pandas", "scipy", "pydantic", "can", "pymodbus", "yaml", "bench.commands", "bench.acquisition")


PLANTED = {
    "sound": ("", ""),
    "a loss": ("LOST = range(5000, 5003)", "reads or lost"),
    "a lag": ("LAG_S = 12.0", "lost or bias"),
    "a wrong byte order": ('ORDER = "<"', "reads or set_point"),
    "an ignored set point": ("SETPOINT = 102", "set_point"),
}
"""What is changed in the firmware, and which of its tests are run."""
RUN = """
import os, pytest, sys
for name, chosen in zip(sys.argv[1::2], sys.argv[2::2]):
    os.chdir(name)
    plugins = ["-p", "bench.testing.plugin", "-p", "no:cacheprovider"]
    pytest.main(["-q", *plugins, f"--junit-xml=../{name}.xml", "-k", chosen])
    for module in ("firmware", "test_firmware"):
        sys.modules.pop(module, None)
    sys.path.remove(os.getcwd())
    os.chdir("..")
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory) -> dict[str, ElementTree.Element]:
    """What the tests of the firmware's makers say, one process for all: pytest in this one would load modules twice."""
    folder = tmp_path_factory.mktemp("projects")
    for name, (line, _) in PLANTED.items():
        shutil.copytree(PROJECT, folder / name)
        firmware = folder / name / "firmware.py"
        firmware.write_text(firmware.read_text().replace("\nBIG = ", f"\n{line}\nBIG = "))
    arguments = [word for name, (_, chosen) in PLANTED.items() for word in (name, chosen)]
    done = subprocess.run(
        [sys.executable, "-c", RUN, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return {name: ElementTree.parse(folder / f"{name}.xml").getroot() for name in PLANTED}


def failed(root: ElementTree.Element) -> dict[str, str]:
    return {case.get("name"): found.text for case in root.iter("testcase") for found in case.iter("failure")}


def test_a_sound_firmware_passes(told):
    assert len(told["sound"].findall(".//testcase")) == 4
    assert not [case for case in told["sound"].iter("testcase") if len(case)]


@pytest.mark.parametrize(
    ("planted", "test", "said"),
    [
        ("a loss", "test_no_sample_is_lost", "assert 3 == 0"),
        ("a lag", "test_its_bias_follows_its_thermometer", "thermal_lag"),
        ("a wrong byte order", "test_the_bench_reads_it", "<Outcome aborted, exit code 3: not started: unit too "),
        ("an ignored set point", "test_the_chamber_takes_the_set_point", "60.0 ± 1"),
    ],
)
def test_what_is_planted_in_the_firmware_is_found(told, planted, test, said):
    assert len(told[planted].findall(".//testcase")) == len(PLANTED[planted][1].split(" or "))
    assert failed(told[planted]).keys() == {test}
    assert said in failed(told[planted])[test]


def test_pytest_finds_the_plugin_by_its_entry_point():
    points = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]["entry-points"]
    # Its name is its module: given once more with -p, it is the same plugin.
    assert points["pytest11"] == {PLUGIN: PLUGIN}


def test_a_project_that_does_not_use_it_loads_nothing_for_it():
    code = f"import pytest, sys; before = set(sys.modules); import {PLUGIN}; print(*set(sys.modules) - before)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert PLUGIN in loaded
    assert [name for name in loaded if name in HEAVY] == []
    assert len([name for name in loaded if name.startswith("bench")]) <= 3


def test_a_project_of_others_is_thirty_lines():
    counted = [len(file.read_text().splitlines()) for file in PROJECT.glob("test_*.py")]
    assert counted <= [30]


@pytest.mark.slow
def test_the_commands_of_the_workflows_run(tmp_path):
    pages = Path(__file__).parents[2] / "docs" / "howto" / "ci"
    github = yaml.safe_load((pages / "github.yml").read_text())["jobs"]["bench"]["steps"]
    gitlab = yaml.safe_load((pages / "gitlab-ci.yml").read_text())["bench"]
    container = (pages / "Containerfile").read_text()
    commands = [step["run"] for step in github if "run" in step]
    assert gitlab["script"] == commands
    assert [f"RUN {commands[0]}"] == re.findall(r"^RUN .*", container, re.MULTILINE)
    assert json.loads(re.search(r"^CMD (.*)", container, re.MULTILINE)[1]) == commands[1].split()
    shutil.copytree(PROJECT, tmp_path / "own")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    # What is installed here is enough for the first command: nothing is downloaded.
    environment = {**os.environ, "PATH": path, "PIP_NO_INDEX": "1", "PYTEST_ADDOPTS": f"-p {PLUGIN} -k set_point"}
    for command in commands:
        done = subprocess.run(
            command.split(), check=False, cwd=tmp_path / "own", env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    for name, tests in zip(gitlab["artifacts"]["reports"]["junit"], (1, 6), strict=True):
        suites = ElementTree.parse(tmp_path / "own" / name).getroot()
        assert len(suites.findall(".//testcase")) == tests
        assert not suites.findall(".//failure")
        assert not suites.findall(".//error")


def test_a_chamber_stands_where_a_driver_left_it(bench_chamber):
    chamber = bench_chamber(chamber=PROJECT / "chamber.yaml", start_degc=20.0)
    with ModbusTcpClient("127.0.0.1", port=chamber.port) as client:
        client.write_register(100, 0x10000 - 150)
        assert (chamber.setpoint_degc, chamber.on) == (-15.0, False)
        client.write_coil(5, True)
        chamber.advance(300)
        assert client.read_holding_registers(101).registers[0] == pytest.approx(0x10000 - 150, abs=10)
    assert chamber.on
    assert chamber.now_s == 300.0


def test_faults_of_the_chamber_by_name(bench_chamber):
    chamber = bench_chamber(chamber=PROJECT / "chamber.yaml", faults=["ignore"])
    chamber.advance(1)  # faults begin when time passes
    with ModbusTcpClient("127.0.0.1", port=chamber.port) as client:
        assert not client.write_register(100, 400).isError()
    assert chamber.setpoint_degc == 25.0


def test_time_passes_in_the_background_for_programs_that_wait(bench_chamber):
    chamber = bench_chamber()
    with chamber.running(speed=1000.0):
        while chamber.now_s < 5.0:
            pass
    stopped = chamber.now_s
    chamber.advance(1.0)
    assert chamber.now_s == stopped + 1.0


def test_a_unit_sends_on_a_virtual_bus(bench_unit):
    unit = bench_unit(effects=["thermal_lag"], faults=[{"fault": "loss", "on": "UNIT-1", "share": 0.5, "at_s": 1.0}])
    bus = unit.open()
    unit.advance(1.0)
    whole = [message for message in iter(lambda: bus.recv(0.0), None) if message.arbitration_id == 0x120]
    assert len(whole) == 500
    unit.advance(1.0)
    half = [message for message in iter(lambda: bus.recv(0.0), None) if message.arbitration_id == 0x120]
    assert 150 < len(half) < 350


def test_a_unit_sends_through_a_serial_line_adapter(bench_unit):
    unit = bench_unit(slcan=True)
    bus = unit.open()
    assert unit.bus["interface"] == "slcan"
    unit.advance(0.02)
    message = bus.recv(5.0)
    assert isinstance(message, can.Message)
    assert message.arbitration_id in {0x120, 0x130, 0x140, 0x150, 0x700, 0x160, 0x170}


def test_a_rate_table_obeys_a_program_of_ours_and_of_others(bench_rate_table):
    table = bench_rate_table()
    network = canopen.Network(table.open())
    network.connect()
    try:
        node = network.add_node(table.node, object_dictionary=canopen.ObjectDictionary())
        status = int.from_bytes(node.sdo.upload(0x6041, 0), "little")
    finally:
        network.disconnect()
    assert status & 0x4F == 0x40  # CiA 402: switch on disabled
    table.advance(1.0)
    assert table.rate_dps == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"effects": ["thermal_lagg"]}, "unknown mechanism 'thermal_lagg'; did you mean 'thermal_lag'"),
        ({"faults": ["losss"]}, "fault 'losss' is not known; did you mean 'loss'"),
        ({"chamber": "nowhere.yaml"}, "nowhere.yaml"),
        ({"station": "here.yaml", "seed": 2}, "leave out seed"),
    ],
)
def test_what_is_wrong_with_the_options_is_said(bench_station, options, said):
    from bench.base import BenchError
    from drivers.errors import DriverError

    with pytest.raises((BenchError, DriverError), match=said):
        bench_station(**options).run()


def test_a_station_file_of_the_users_own(bench_station, tmp_path):
    made = bench_station(signals={"rate": {"id": 1, "start": 0, "length": 32, "unit": "deg/h"}, "cycle_ms": 2})
    assert made.settings.units[0].serial == "UNIT-1"
    assert bench_station(station=made.folder / "station.yaml").settings.name == made.settings.name
