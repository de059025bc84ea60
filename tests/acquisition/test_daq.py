"""A package of others delivers samples of a gyro by an entry point: recorded without loss, and gaps are counted."""

import json
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from bench.acquisition.run.runner import run_job
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.wires import wire_findings
from bench.base import InputError, load_config, parse_yaml
from bench.record import load
from drivers.can_record import FLAG_ERROR
from drivers.canbus import BusSettings, ProcessCapture, open_bus
from drivers.errors import ConfigError, LinkError
from drivers.framing import Framing
from drivers.gyro import GyroDecoder
from tests.support import acquisition

PACKAGE = '''
"""A device of others: blocks of 50 samples, the number of samples that `options` say, and a gap where they say."""
import time
import numpy as np
from drivers.daq import SampleBlock


class Device:
    sample_s = 0.002

    def __init__(self, blocks, lose, endless):
        self.blocks, self.lose, self.endless, self.number, self.started_s = blocks, lose, endless, 0, time.time()

    def read(self, timeout_s):
        number = self.number
        if not self.endless and number >= self.blocks:
            return None
        due_s = self.started_s + 0.1 * (number + 1)
        if self.endless and time.time() < due_s:
            time.sleep(min(0.05 if timeout_s is None else timeout_s, 0.05))
            return None
        self.number += 1
        if number == self.lose:
            return self.read(timeout_s)
        at = 50 * number + np.arange(50)
        return SampleBlock(50 * number, np.stack([1e-3 * (at % 1000), np.full(50, 0.25)], 1), due_s)

    def close(self):
        pass


def open_device(device, blocks=10, lose=-1, endless=False):
    if device != "Dev1":
        raise OSError(f"no device {device}")
    return Device(blocks, lose, endless)


def narrow(device):
    class Narrow(Device):
        def read(self, timeout_s):
            return SampleBlock(0, np.zeros((3, 1)))

    return Narrow(1, -1, False)


def broken(device):
    class Broken(Device):
        def read(self, timeout_s):
            raise RuntimeError("its library gave up")

    return Broken(1, -1, False)
'''
BUS = {"interface": "packets", "channel": "daq:acme/Dev1", "framing": {"kind": "datagram", "length": 24}}
UNIT = {
    "serial": "DAQ-1",
    "bus": "daq0",
    "signals": {
        "counter": {"id": 0, "start": 0, "length": 32},
        "rate": {"id": 0, "start": 64, "length": 64, "type": "float", "scale": 20, "unit": "deg/s", "bytes": 24},
        "temperature": {"id": 0, "start": 128, "length": 64, "type": "float", "scale": 100, "unit": "degC"},
        "cycle_ms": 2,
    },
}
FRAMING = Framing("datagram", length=24)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """The package as pip would install it: a module and a dist-info with its entry points."""
    folder = tmp_path / "site"
    info = folder / "acme_bench-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / "acme_bench.py").write_text(textwrap.dedent(PACKAGE))
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-bench\nVersion: 1.0\n")
    names = {"acme": "open_device", "narrow": "narrow", "broken": "broken", "gone": "absent"}
    lines = "".join(f"{name} = acme_bench:{target}\n" for name, target in names.items())
    (info / "entry_points.txt").write_text(f"[bench.daq]\n{lines}")
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "acme_bench", raising=False)
    return folder


def opened(channel="daq:acme/Dev1", **options):
    return open_bus(BusSettings("packets", channel, framing=FRAMING, options=options))


def test_samples_are_frames_with_their_own_times(package):
    bus = opened(blocks=4)
    frames = bus.recv_block(0.0)
    bus.shutdown()
    assert len(frames) == 200
    assert np.diff(frames["t_ns"]) == pytest.approx(2e6, rel=1e-3)
    raw = np.ascontiguousarray(frames["data"])
    assert raw.view("<u8")[:, 0].tolist() == list(range(200))
    assert raw.view("<f8")[:, 1] == pytest.approx(1e-3 * np.arange(200))
    assert not (frames["flags"] & FLAG_ERROR).any()


@pytest.mark.parametrize("lose", [-1, 5])
def test_what_the_device_lost_is_counted(package, lose):
    unit = station()["units"][0]
    settings = load_config(parse_yaml(json.dumps(station()), "station.yaml"), StationSettings)
    decoder: GyroDecoder = settings.units[0].decoder()
    bus = opened(blocks=10, lose=lose)
    block = decoder.decode(bus.recv_block(0.0))
    bus.shutdown()
    lost = 0 if lose < 0 else 50
    assert len(block.index) == 500 - lost
    assert decoder.losses.as_dict()["lost"] == lost
    assert block.rate_dph[7] == pytest.approx(20 * 7e-3 * 3600)
    assert unit["serial"] == "DAQ-1"


def station(**changes):
    found = acquisition.station_content(units=[UNIT], buses={"daq0": {**BUS, **changes}})
    found.pop("instruments")
    return found


@pytest.mark.parametrize(
    ("channel", "options", "error", "said"),
    [
        ("daq:acne/Dev1", {}, ConfigError, "no installed package offers 'acne' .*known: acme, broken, gone, narrow"),
        ("daq:gone/Dev1", {}, ConfigError, "acme_bench:absent cannot be loaded"),
        ("daq:acme/Dev2", {}, LinkError, "does not open: no device Dev2"),
        ("daq:acme/Dev1", {"blocs": 3}, ConfigError, "blocs.*see `channel` and `options`"),
    ],
)
def test_what_does_not_open_is_said(package, channel, options, error, said):
    with pytest.raises(error, match=said):
        opened(channel, **options)


@pytest.mark.parametrize(("name", "said"), [("narrow", r"has the shape \(3, 1\)"), ("broken", "its library gave up")])
def test_a_device_that_fails_is_a_failure_of_its_bus(package, name, said):
    bus = opened(f"daq:{name}/Dev1")
    with pytest.raises(OSError, match=said):
        bus.recv(0.0)
    bus.shutdown()


@pytest.mark.parametrize("framing", [{"kind": "slip"}, {"kind": "datagram"}, {"kind": "datagram", "length": 20}])
def test_a_framing_that_samples_cannot_have_is_refused(framing):
    with pytest.raises(InputError, match="samples of a device are `kind: datagram` with `length: 8`"):
        load_config(parse_yaml(json.dumps(station(framing=framing)), "station.yaml"), StationSettings)


def test_a_capture_process_finds_the_package_and_loses_nothing(package, tmp_path):
    """Fifty blocks at once: what is read is what the device counted."""
    capture = ProcessCapture(
        BusSettings("packets", "daq:acme/Dev1", framing=FRAMING, options={"blocks": 50}), tmp_path / "a.gtbj", 0
    )
    count = 0
    try:
        while count < 2500:
            count += len(capture.poll())
            assert capture.health().error is None
    finally:
        capture.close()
    assert count + len(capture.poll()) == 2500


def test_the_station_of_the_page_runs_on_the_simulator(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "howto" / "lines.md").read_text()
    example = parse_yaml(page.split("## A data acquisition")[1].split("```yaml\n")[1].split("```")[0], "page").content
    settings = load_config(parse_yaml(json.dumps(station() | example), "station.yaml"), StationSettings)
    assert not [one for one in wire_findings(settings) if one.level == "error"]
    result = run_job(acquisition.job(tmp_path, settings=settings))
    assert result.error is None
    assert result.run.manifest().losses["lost"] == 0


@pytest.mark.slow
def test_a_run_on_a_device_of_others(package, tmp_path):
    with acquisition.elsewhere(acquisition.station(instruments=[])) as served:
        buses = {"daq0": {**BUS, "options": {"endless": True}}}
        content = served.station_file() | {"units": [UNIT], "buses": buses}
        settings = load_config(parse_yaml(json.dumps(content), "station.yaml"), StationSettings)
        text = "name: real\nsegments:\n  - {kind: soak, duration_min: 0.1}\n"
        result = run_job(acquisition.job(tmp_path, text, settings))
    assert result.error is None
    losses = result.run.manifest().losses
    assert {name for name, count in losses.items() if count} == {"received"}
    assert load(result.run.path, 1.0).channel("temperature") == pytest.approx(25.0)
