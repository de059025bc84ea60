"""Units of any layout: what cantools encodes is what the decoder delivers, each channel on its sample."""

import struct
from pathlib import Path

import cantools
import numpy as np
import pytest

from drivers.bus_load import load
from drivers.can_record import FLAG_EXTENDED, FLAG_FD, frame_type
from drivers.errors import ConfigError
from drivers.gyro import GyroDecoder
from drivers.journal import FRAME
from drivers.layout import layout_of
from drivers.sim.can_unit import CanUnit
from drivers.wire import described
from tests.drivers.test_gyro import Wire

AXES = ("x", "y", "z")
FD = """VERSION ""
NS_ :
BS_:
BU_: Imu
BO_ 2566844672 INERTIAL: 48 Imu
 SG_ GyroX : 7|24@0- (0.00001,0) [0|0] "deg/s" Imu
 SG_ GyroY : 24|32@1- (0.000001,0) [0|0] "deg/s" Imu
 SG_ GyroZ : 56|32@1- (0.000001,0) [0|0] "deg/s" Imu
 SG_ AccX : 103|20@0- (0.00001,0) [0|0] "g" Imu
 SG_ AccY : 128|32@1- (0.000001,0) [0|0] "m/s^2" Imu
 SG_ AccZ : 165|29@1- (0.00001,0) [0|0] "m/s^2" Imu
 SG_ Warm1 : 200|16@1- (0.01,0) [0|0] "degC" Imu
 SG_ Warm2 : 216|16@1- (0.01,0) [0|0] "degC" Imu
 SG_ Tick : 232|16@1+ (1,0) [0|0] "" Imu
 SG_ Health : 370|3@1+ (1,0) [0|0] "" Imu
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "GenMsgCycleTime" BO_ 2566844672 2;
BA_ "VFrameFormat" BO_ 2566844672 3;
"""
MAP = {
    **{f"rate_{axis}": f"Gyro{axis.upper()}" for axis in AXES},
    **{f"acceleration_{axis}": f"INERTIAL.Acc{axis.upper()}" for axis in AXES},
    "temperature_1": "Warm1", "temperature_2": "Warm2", "counter": "Tick",
    "status": [{"signal": "Health", "valid": "2"}],
}  # fmt: skip


@pytest.fixture
def dbc(tmp_path):
    (tmp_path / "imu.dbc").write_text(FD)
    return tmp_path / "imu.dbc"


def recorded(messages, room=64, cycle_ns=2_000_000):
    """Records of (identifier, data) in the order of arrival, each with its sample."""
    frames = np.zeros(len(messages), dtype=frame_type(room))
    for row, (sample, identifier, data) in enumerate(messages):
        frames[row]["t_ns"], frames[row]["id"] = sample * cycle_ns + row % 3, identifier & 0x1FFFFFFF
        frames[row]["flags"] = FLAG_EXTENDED * (identifier > 0x7FF) | FLAG_FD * (room == 64)
        frames[row]["len"] = len(data)
        frames[row]["data"][: len(data)] = np.frombuffer(data, np.uint8)
    return frames


def test_six_outputs_in_one_long_frame_are_those_that_cantools_encoded(dbc):
    message = cantools.database.load_file(dbc).get_message_by_name("INERTIAL")
    random = np.random.default_rng(1)
    said = [
        {
            "GyroX": random.uniform(-80, 80), "GyroY": random.normal(0, 5), "GyroZ": random.normal(0, 5),
            "AccX": random.uniform(-4, 4), "AccY": random.normal(0, 9), "AccZ": random.normal(0, 9),
            "Warm1": 20 + k / 100, "Warm2": 30 - k / 100, "Tick": k & 0xFFFF, "Health": 2 if k != 40 else 5,
        }
        for k in range(100)
    ]  # fmt: skip
    frames = recorded([(k, message.frame_id, bytes(message.encode(one))) for k, one in enumerate(said) if k != 7])
    decoder = GyroDecoder(dbc, 0, MAP)
    block = decoder.decode(frames)
    assert (decoder.outputs, decoder.output) == (tuple(MAP)[:6], "rate_x")
    assert block.index.tolist() == [k for k in range(100) if k != 7]
    assert decoder.losses.lost == 1
    assert np.flatnonzero(~block.valid).tolist() == [39]
    scales = {"rate": 3600.0, "acceleration_x": 9.80665}
    for channel, signal in ((name, MAP[name].split(".")[-1]) for name in list(MAP)[1:8]):
        factor = scales.get(channel, 3600.0 if channel.startswith("rate") else 1.0)
        series = block.slow[channel]
        assert series.index.tolist() == [k for k in range(100) if k not in (7, 40)]
        decoded = [message.decode(bytes(message.encode(said[k])))[signal] * factor for k in series.index.tolist()]
        np.testing.assert_allclose(series.value, decoded, rtol=1e-12)
    assert decoder.thermometer.channel == "temperature_1"


def test_a_number_is_added_to_a_29_bit_identifier(dbc):
    frames = recorded([(0, 0x18FF0203, bytes(48))])
    assert len(GyroDecoder(dbc, 3, MAP).decode(frames).index) == (0x18FF0203 == 2566844672 % (1 << 29) + 3)


MANY = {
    "rate_x": {"id": 0x100, "start": 7, "length": 32, "order": "big", "type": "signed", "scale": 1e-6, "unit": "deg/s",
               "cycle_ms": 2},
    "rate_y": {"id": 0x101, "start": 0, "length": 24, "type": "signed", "scale": 1e-5, "unit": "deg/s", "cycle_ms": 2},
    "acceleration_z": {"id": 0x102, "start": 0, "length": 32, "type": "float", "unit": "m/s^2", "cycle_ms": 2},
    "temperature_1": {"id": 0x200, "start": 0, "length": 16, "type": "signed", "scale": 0.01, "unit": "degC",
                      "cycle_ms": 20},
    "counter": [{"id": 0x100, "start": 32, "length": 16}, {"id": 0x101, "start": 24, "length": 8}],
}  # fmt: skip


def sent(signals, count=1000, **options):
    """Frames of a unit whose channels are ramps, and the ramps."""
    layout, wire = layout_of(None, signals), Wire()
    values = {name: (1 + n) * np.arange(count) * 0.036 for n, name in enumerate(layout.channels)}
    CanUnit(wire, layout, 0, 7, **options).send(0.0, values)
    return wire.blocks[0], values


@pytest.mark.parametrize("blocks", [1, 13])
def test_an_output_in_a_frame_of_its_own_stands_on_its_sample_without_a_dbc(blocks):
    frames, values = sent(MANY)
    keep = np.ones(len(frames), bool)
    keep[np.flatnonzero(frames["id"] == 0x101)[[5, 500]]] = False
    decoder, found = GyroDecoder(None, 0, MANY), {}
    for part in np.array_split(frames[keep], blocks):
        block = decoder.decode(part)
        for name, series in block.slow.items():
            found.setdefault(name, []).append(series)
    for name, parts in found.items():
        index, value = (np.concatenate([getattr(part, what) for part in parts]) for what in ("index", "value"))
        np.testing.assert_allclose(value, values[name][index], atol=0.02, err_msg=name)
        assert len(index) == {"rate_y": 998, "acceleration_z": 1000, "temperature_1": 100}[name]
    assert decoder.losses.slow_lost == 2


def test_a_unit_without_counter_and_heartbeat_is_counted_by_its_cycle_time_and_says_what_is_lost():
    signals = {name: MANY[name] for name in ("rate_x", "rate_y")}
    frames, _ = sent(signals)
    rows = np.flatnonzero(frames["id"] == 0x100)
    frames["t_ns"] += np.random.default_rng(2).integers(0, 600_000, len(frames))  # jitter of a busy computer
    frames["t_ns"] = np.maximum.accumulate(frames["t_ns"])
    frames["t_ns"][rows[300:306]] = frames["t_ns"][rows[305]]  # six come late, together: none is lost
    decoder = GyroDecoder(None, 0, signals)
    block = decoder.decode(np.delete(frames, rows[[100, 101, 700]]))
    assert sorted(set(range(1000)) - set(block.index.tolist())) == [100, 101, 700]
    assert decoder.losses.lost == 3
    assert decoder.identity is None
    lacks = " ".join(decoder.layout.lacks())
    for word in ("no counter", "no serial number", "no thermometer", "no status", "no CRC"):
        assert word in lacks


@pytest.mark.parametrize(
    "counts",
    [
        {"time_stamp": {"id": 0x100, "start": 32, "length": 24, "scale": 10.0, "unit": "us"}},
        {"counter": {"id": 0x100, "start": 32, "length": 10, "scale": 0.5}},
        {"counter": {"id": 0x100, "start": 32, "length": 16, "scale": 1 / 3}},
    ],
)
def test_a_time_stamp_takes_the_place_of_a_counter_and_so_does_one_that_grows_by_more_than_1(counts):
    signals = {"rate_x": MANY["rate_x"], **counts}
    frames, _ = sent(signals, count=2000)
    decoder = GyroDecoder(None, 0, signals)
    assert decoder.decode(np.delete(frames, [3, 4, 1500])).index.tolist() == [
        k for k in range(2000) if k not in (3, 4, 1500)
    ]
    assert (decoder.losses.lost, decoder.losses.resets) == (3, 0)


@pytest.mark.parametrize("step", [1, 2, 5])
def test_by_how_much_a_counter_grows_is_told(step):
    counter = {"id": 0x100, "start": 32, "length": 16}
    frames, _ = sent({"rate_x": MANY["rate_x"], "counter": {**counter, "scale": 1 / step}}, count=50)
    decoder = GyroDecoder(None, 0, {"rate_x": MANY["rate_x"], "counter": counter})
    assert decoder.counter_step(np.delete(frames, 3)) == step


MUX = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 288 AXES: 8 A
 SG_ Which M : 0|8@1+ (1,0) [0|0] "" A
 SG_ RateX m0 : 8|24@1- (0.00001,0) [0|0] "deg/s" A
 SG_ RateY m1 : 15|24@0- (0.00001,0) [0|0] "deg/s" A
 SG_ Warm m2 : 8|16@1- (0.01,0) [0|0] "degC" A
 SG_ Count : 48|16@1+ (1,0) [0|0] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 288 4;
"""


def test_outputs_of_a_multiplexed_message_are_told_apart(tmp_path):
    (tmp_path / "mux.dbc").write_text(MUX)
    message = cantools.database.load_file(tmp_path / "mux.dbc").get_message_by_name("AXES")
    rows = []
    for k in range(60):
        for which, name, value in ((0, "RateX", k * 0.1), (1, "RateY", -k * 0.2), (2, "Warm", 20 + k)):
            data = message.encode({"Which": which, name: value, "Count": k}, strict=False)
            rows.append((k, 288, bytes(data)))
    signals = {"rate_x": "RateX", "rate_y": "RateY", "temperature_1": "Warm", "counter": "Count"}
    block = GyroDecoder(tmp_path / "mux.dbc", 0, signals).decode(recorded(rows, room=8, cycle_ns=4_000_000))
    np.testing.assert_allclose(block.rate_dph, np.arange(60) * 360.0, atol=1e-6)
    np.testing.assert_allclose(block.slow["rate_y"].value, -np.arange(60) * 720.0, atol=1e-6)
    assert block.slow["rate_y"].index.tolist() == block.slow["temperature_1"].index.tolist() == list(range(60))


@pytest.mark.parametrize(
    ("unit", "dph"),
    [("°/s", 3600.0), ("Â°/s", 3600.0), ("dps", 3600.0), ("mdps", 3.6), ("°/h", 1.0), ("rad/s", 648000 / np.pi)],
)
def test_units_of_rates_are_those_that_import_takes(unit, dph):
    where = {"id": 0x100, "start": 0, "length": 32, "type": "signed", "scale": 0.5, "unit": unit}
    block = GyroDecoder(None, 0, {"rate": where, "cycle_ms": 4}).decode(
        recorded([(k, 0x100, struct.pack("<i", 2 * k)) for k in range(3)], room=8, cycle_ns=4_000_000)
    )
    np.testing.assert_allclose(block.rate_dph, np.arange(3) * dph, rtol=1e-12)


@pytest.mark.parametrize(
    ("unit", "scale", "raw"), [("K", 0.1, 2982), ("°F", 1.0, 77), ("C", 0.1, 250), ("°C", 0.1, 250)]
)
def test_units_of_temperatures_are_those_that_import_takes(unit, scale, raw):
    warm = {"id": 0x200, "start": 0, "length": 16, "scale": scale, "unit": unit, "cycle_ms": 4}
    rate = {"id": 0x100, "start": 0, "length": 32, "unit": "dps"}
    frames = [(k, 0x100, struct.pack("<I", k)) for k in range(4)] + [
        (k, 0x200, struct.pack("<H", raw)) for k in range(4)
    ]
    decoder = GyroDecoder(None, 0, {"rate": rate, "temperature": warm, "cycle_ms": 4})
    block = decoder.decode(recorded(sorted(frames), room=8, cycle_ns=4_000_000))
    np.testing.assert_allclose(block.slow["temperature"].value, 25.0, atol=0.06)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"rate_x": "Gyro"}, "signals: rate_x: 'Gyro' is not in the DBC; it has INERTIAL.GyroX"),
        ({"rate_x": "Tick"}, "INERTIAL.Tick has the unit ''"),
        ({"status": [{"signal": "Health"}]}, "status Health needs `valid` or `raw`"),
        ({"rate_x": {"id": 5, "start": 500, "length": 32}}, "0x5"),
        (dict.fromkeys(list(MAP)[:6]), "signals: no output"),
    ],
)
def test_a_mapping_that_cannot_be_used_is_named(dbc, change, complaint):
    signals = {key: value for key, value in {**MAP, **change}.items() if value is not None}
    with pytest.raises(ConfigError, match=complaint):
        GyroDecoder(dbc, 0, signals)


def test_long_frames_on_a_classical_bus_are_not_read_as_something_else(dbc):
    frames = np.zeros(5, dtype=FRAME)
    frames["id"], frames["len"], frames["flags"] = 2566844672 % (1 << 29), 8, FLAG_EXTENDED
    decoder = GyroDecoder(dbc, 0, MAP)
    assert not len(decoder.decode(frames).index)
    assert decoder.losses.corrupt == 5


def test_the_load_of_a_bus_is_that_of_the_worst_bits():
    """A classical frame with 8 bytes has 135 bits, with a 29-bit identifier 160: 7407 and 6250 frames a second."""
    for identifier, bits in ((0x120, 135), (0x18FF0120, 160)):
        (message,) = described([{"id": identifier, "start": 0, "length": 64, "cycle_ms": 1.0}]).values()
        assert load([message], 1_000_000) == pytest.approx(bits * 1e-3)
    (long,) = described([{"id": 0x120, "start": 448, "length": 64, "cycle_ms": 1.0}]).values()
    assert 0.1018 < load([long], 1_000_000, 8_000_000, fd=True) < 0.12  # 101.8 us with the stuff bits of random data


FAMILY = (Path(__file__).parents[2] / "drivers" / "gyros" / "vibratory.dbc").read_text()


@pytest.mark.parametrize(
    ("old", "new", "lost"),
    [
        (" SG_ SampleCounter ", " SG_ Count ", "no counter and no time stamp"),
        (" SG_ Temperature ", " SG_ Warmth ", "no thermometer"),
        (" SG_ Serial ", " SG_ Number ", "no serial number"),
        (" SG_ Crc8 ", " SG_ Sum ", "no CRC"),
    ],
)
def test_a_dbc_of_the_usual_names_may_lack_all_but_the_rate_and_says_what_is_lost(tmp_path, old, new, lost):
    path = tmp_path / "own.dbc"
    path.write_text(FAMILY.replace(old, new))
    assert lost in " ".join(layout_of(path).lacks())
    assert not [*layout_of("vibratory").lacks()]


def test_a_thermometer_without_a_counter_of_its_own_is_read(tmp_path):
    path = tmp_path / "own.dbc"
    path.write_text(FAMILY.replace(" SG_ SlowCounter ", " SG_ Slow "))
    assert layout_of(path).channels.keys() == layout_of("vibratory").channels.keys()


def test_all_that_is_wrong_with_a_mapping_is_said_at_once(dbc):
    signals = {**MAP, "rate_x": "Gyro", "rate_y": "Tick", "status": [{"signal": "Health"}], "serial": "Nobody"}
    with pytest.raises(ConfigError) as caught:
        layout_of(dbc, signals)
    for part in (
        "rate_x: 'Gyro' is not in the DBC",
        "INERTIAL.Tick has the unit ''",
        "Health needs `valid`",
        "serial: ",
    ):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_every_frame_of_a_multiplexed_message_carries_is_taken_once_a_sample(tmp_path):
    (tmp_path / "axes.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: BENCH\nBO_ 768 AXES: 8 GYRO\n SG_ Which M : 0|8@1+ (1,0) [0|2] "" BENCH\n'
        ' SG_ X m0 : 8|16@1- (1,0) [0|0] "deg/s" BENCH\n SG_ Y m1 : 8|16@1- (1,0) [0|0] "deg/s" BENCH\n'
        ' SG_ T : 24|16@1- (1,0) [0|0] "degC" BENCH\n'
    )
    layout = layout_of(tmp_path / "axes.dbc", {"rate_x": "X", "rate_y": "Y", "temperature": "T", "cycle_ms": 10})
    assert layout.first.channels.keys() == {"rate_x", "temperature"}
    assert [source.channels.keys() for source in layout.others] == [{"rate_y"}]
