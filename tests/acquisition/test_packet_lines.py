"""Gyros that are not on CAN: a run, its journal and the doctor are as on CAN."""

import copy
import json
import os
import socket
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml

from bench.acquisition.run.runner import run_job
from bench.acquisition.station.doctor import examine
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.wires import wire_findings
from bench.base import InputError, load_config, parse_yaml
from bench.record import load
from bench.record.samples import read_samples
from drivers.framing import Framing
from drivers.packet_bus import MemoryLine, PacketBus
from tests.support import acquisition
from tests.support.commands import bench

CRC = {"width": 16, "poly": 0x1021, "init": 0xFFFF, "order": "big"}
LINES = {
    "slip": {"kind": "slip", "crc": CRC},
    "cobs": {"kind": "cobs", "length": 18, "crc": CRC},
    "header": {"kind": "header", "header": "AA 55", "length": 18, "crc": {**CRC, "start": 2}},
    "datagram": {"kind": "datagram", "crc": CRC},
}
BIG = {"id": 0, "order": "big"}
SIGNALS = {
    "rate": BIG | {"start": 23, "length": 32, "type": "signed", "scale": 1e-6, "unit": "deg/s", "bytes": 18},
    "temperature": BIG | {"start": 55, "length": 32, "type": "float", "unit": "degC"},
    "counter": BIG | {"start": 87, "length": 16},
    "cycle_ms": 2,
}


def content(kind: str = "header", channel: str = "/dev/ttyUSB0", **framing: object) -> dict:
    line = {"interface": "packets", "channel": channel, "bitrate": 921600, "framing": LINES[kind] | framing}
    unit = {"serial": "LINE-1", "bus": "line0", "signals": copy.deepcopy(SIGNALS)}
    found = acquisition.station_content(units=[unit], buses={"line0": line})
    found.pop("instruments")
    return found


def station(given: dict) -> StationSettings:
    return load_config(parse_yaml(json.dumps(given), "station.yaml"), StationSettings)


@pytest.mark.parametrize("kind", LINES)
def test_a_run_over_packets_loses_nothing(kind, tmp_path):
    result = run_job(acquisition.job(tmp_path, settings=station(content(kind))))
    assert result.error is None
    manifest = result.run.manifest()
    assert {name for name, count in manifest.losses.items() if count} == {"received"}
    assert manifest.sample_rate_hz == 500
    data = load(result.run.path, 1.0)
    assert np.nanmax(np.abs(data.channels["temperature"] - data.channels["chamber_temperature"])) < 5.0


@pytest.mark.parametrize("counted", [True, False], ids=["by its counter", "by its cycle time"])
def test_packets_that_are_lost_or_broken_are_counted(tmp_path, counted):
    given = content()
    if not counted:
        del given["units"][0]["signals"]["counter"]
    given["faults"] = [{"at_s": 10, "on": "LINE-1", "fault": "silence", "for_s": 2}]
    manifest = run_job(acquisition.job(tmp_path, settings=station(given))).run.manifest()
    assert manifest.losses["lost"] == 1000


SPOILT = {
    "noise between packets": lambda packet, k: bytes([0xAA, 0x55, k % 256]) + packet,
    "a byte too few": lambda packet, k: packet[: k % len(packet)] + packet[k % len(packet) + 1 :],
    "cut": lambda packet, k: packet[: k % len(packet)],
    "a flipped bit": lambda packet, k: packet[:5] + bytes([packet[5] ^ 1]) + packet[6:],
}


@pytest.mark.parametrize("kind", ["header", "cobs"])
@pytest.mark.parametrize("spoilt", SPOILT)
def test_bytes_that_are_wrong_cost_their_packets_and_are_counted(tmp_path, monkeypatch, kind, spoilt):
    """Every 23rd packet for 20 s; what is between two COBS packets is part of the next one."""
    sent, write = [], MemoryLine.write

    def send(line, data, t_s):
        sent.append(t_s)
        bad = 10 < t_s < 30 and len(sent) % 23 == 0
        write(line, SPOILT[spoilt](data, len(sent)) if bad else data, t_s)

    monkeypatch.setattr(MemoryLine, "write", send)
    run = run_job(acquisition.job(tmp_path, settings=station(content(kind)))).run
    losses = {name: count for name, count in run.manifest().losses.items() if count and name != "received"}
    struck = len([t_s for k, t_s in enumerate(sent, 1) if 10 < t_s < 30 and k % 23 == 0])
    if (kind, spoilt) == ("header", "noise between packets"):
        assert losses == {}
    else:
        assert losses.keys() == {"lost"}
        assert 0.8 * struck <= losses["lost"] <= 2 * struck  # an end that is lost costs the next packet, too
    times, rates = read_samples(run.data, "time", "rate").values()
    heard = times[np.isfinite(rates)]
    assert len(heard) + losses.get("lost", 0) == round((heard[-1] - heard[0]) * 500) + 1
    [counts] = [event for event in run.events() if event["kind"] == "capture"]
    assert counts["error_frames"] >= 0.8 * struck


UNPLUGGED = [
    (23, 4, None),
    (1e9, 4, "bus line0 link lost for 4 s: [Errno 5] Input/output error"),
    (1e9, 60, "bus line0 is lost: [Errno 5] Input/output error"),
]


@pytest.mark.parametrize(("until_s", "patience_s", "told"), UNPLUGGED, ids=["for 3 s", "for good", "a patient link"])
def test_a_line_that_is_unplugged_is_lost_or_its_gap_counted(tmp_path, monkeypatch, until_s, patience_s, told):
    out, read = [False], MemoryLine.read

    def unplugged(line, timeout):
        if not out[0]:
            return read(line, timeout)
        line._chunks.clear()
        raise OSError(5, "Input/output error")

    def look(_, status):
        out[0] = 20 <= status.t_s < until_s

    monkeypatch.setattr(MemoryLine, "read", unplugged)
    text = acquisition.SHORT if until_s < 1e9 else acquisition.LONG
    given = content()
    given["buses"]["line0"]["link"] = {"degraded_after_s": 1, "lost_after_s": patience_s}
    result = run_job(acquisition.job(tmp_path, text, station(given)), look)
    lost = result.run.manifest().losses["lost"]
    if until_s < 1e9:
        assert (result.error, lost) == (None, 1500)
    else:
        assert (result.error.exit_code, lost) == (4, 0)
        assert str(result.error) == told
    steps = [event["ok"] for event in result.run.events() if event["kind"] == "safe_state" and "ok" in event]
    assert steps
    assert all(steps)


def test_a_serial_server_is_asked_whether_it_is_still_there():
    with socket.create_server(("127.0.0.1", 0)) as server:
        bus = PacketBus(f"socket://127.0.0.1:{server.getsockname()[1]}", Framing("slip", length=8))
        with closing(server.accept()[0]), socket.socket(fileno=os.dup(bus._line._port.fileno())) as own:
            assert own.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        bus.shutdown()


def test_the_doctor_hears_a_unit_on_a_pty_and_on_udp():
    for kind, channel in (("header", "/dev/ttyUSB0"), ("datagram", "udp://0.0.0.0:5005")):
        found = {(one.what, one.verdict) for one in examine(station(content(kind, channel)), 0.5).findings}
        assert {("bus line0", "agrees"), ("unit LINE-1", "agrees")} <= found


def test_the_doctor_says_that_bytes_come_which_are_no_packets(monkeypatch):
    encode = Framing.encode
    monkeypatch.setattr(Framing, "encode", lambda *given: encode(*given)[:-1] + b"?")
    found = {one.what: (one.verdict, one.detail) for one in examine(station(content()), 0.5).findings}
    verdict, detail = found["bus line0"]
    assert verdict == "disagrees"
    assert detail.endswith("all of them bytes that are no packet: compare framing, check sum and baud rate")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"framing": {"kind": "header", "length": 18}}, "packets with a header need `header`"),
        ({"framing": {"kind": "header", "header": "AA"}}, "end by `length`, or by `length_at`; state one of them"),
        ({"framing": {"kind": "slip", "crc": {"width": 8, "poly": 0x1021}}}, "is 0x1021, more than 8 bits"),
        ({"interface": "blocks"}, "interface 'blocks' has no framing; only 'packets' has one"),
        ({"framing": None}, "interface 'packets' needs `framing`"),
        ({"channel": "memory:x"}, "channel 'memory:x' is no line of a unit"),
        ({"fd": True}, "packets are no CAN: leave out `fd`"),
    ],
)
def test_what_is_wrong_with_a_line_is_said(change, said):
    given = content()
    given["buses"]["line0"] |= change
    with pytest.raises(InputError, match=said):
        station(given)


def test_check_compares_the_signals_with_the_framing():
    given = content(length=20)
    errors = [one.text for one in wire_findings(station(given)) if one.level == "error"]
    assert errors == [
        "unit LINE-1: packet 0 has 18 bytes by its signals, 20 by the framing of its line; state `bytes: 20` in one of "
        "them, or correct the line's `length`"
    ]
    given = content()
    given["buses"]["line0"]["bitrate"] = 57600
    assert any("bus line0: its units take 156% of it" in one.text for one in wire_findings(station(given)))


def test_a_unit_on_a_line_is_not_flashed(tmp_path: Path):
    (tmp_path / "station.yaml").write_text(json.dumps(content()))
    from bench.acquisition.station.memory import open_store
    from bench.base import EquipmentError
    from drivers.clock import WallClock

    settings = station(content())
    with (
        pytest.raises(EquipmentError, match="where no protocol writes coefficients; name commands of your own"),
        open_store(settings.buses["line0"], WallClock(), settings.units[0]),
    ):
        pass


def test_the_example_of_the_page_runs(tmp_path: Path):
    page = (Path(__file__).parents[2] / "docs" / "howto" / "lines.md").read_text()
    example = yaml.safe_load(page.partition("```yaml\n")[2].partition("```")[0])
    settings = station(content() | example)
    assert not [one for one in wire_findings(settings) if one.level == "error"]
    result = run_job(acquisition.job(tmp_path, settings=settings))
    assert result.error is None
    assert result.run.manifest().losses["lost"] == 0


def test_check_takes_the_station(tmp_path: Path):
    (tmp_path / "station.yaml").write_text(json.dumps(content()))
    (tmp_path / "short.yaml").write_text(acquisition.SHORT)
    arguments = ["check", str(tmp_path / "short.yaml"), "--station", str(tmp_path / "station.yaml")]
    assert bench(*arguments).exit_code == 0
