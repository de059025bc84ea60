"""Foreign tables in binary formats, spreadsheets, archives and CAN logs."""

import gzip
import struct
import zipfile
from datetime import UTC, datetime
from decimal import Decimal

import can
import cantools
import h5py
import nptdms
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.acquisition.importer.columns import ChannelSource, ColumnMap
from bench.acquisition.importer.tables import read_table
from bench.base.errors import InputError
from drivers.wire import Message
from tests.support.tables import DBC, TABLE, imported, refusal, write


def test_a_zip_archive_with_one_table_is_read_and_one_with_several_names_them(tmp_path):
    path = tmp_path / "log.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("out/", "")
        archive.writestr("out/log.csv", "time,rate [deg/h],temp [degC]\n0,1,20\n1,2,21\n")
    assert imported(path).channels["rate"].tolist() == [1, 2]
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("out/other.csv", "")
    assert "is a zip archive of 2 files: out/log.csv, out/other.csv; " in refusal(path)
    path.write_bytes(path.read_bytes()[:100])
    assert "not a readable zip file" in refusal(path)


def test_durations_and_decimals_of_parquet_are_numbers_and_texts_are_named(tmp_path):
    path, frame = tmp_path / "odd.parquet", pd.DataFrame({"rate": [1.0, 2.0], "temperature": [20.0, 21.0]})
    frame.assign(time=pd.to_timedelta([0, 10], unit="s"), rate=[Decimal("1.5"), Decimal("2.5")]).to_parquet(path)
    plan = imported(path)
    assert (plan.time.tolist(), plan.channels["rate"].tolist()) == ([0, 10], [1.5, 2.5])
    frame.assign(time=[0, 1], rate=["1.5", "2.5"]).to_parquet(path)
    assert "column 'rate' holds" in refusal(path)


def test_files_that_are_not_what_they_say_are_refused(tmp_path):
    assert "no such file" in refusal(tmp_path / "none.csv")
    assert "is a folder" in refusal(tmp_path)
    assert "not a readable Parquet file" in refusal(write(tmp_path, b"PAR1 nonsense", "x.parquet"))
    assert "not a readable MF4 file" in refusal(write(tmp_path, b"nonsense", "x.mf4"))
    assert "a CAN log needs the description of its frames" in refusal(write(tmp_path, "x", "x.asc"))
    assert ":1: is not a text table (byte 1 in it)" in refusal(write(tmp_path, b"\x01\x02time\n"))
    assert "not a readable gzip file" in refusal(write(tmp_path, gzip.compress(b"time,rate\n1,2\n")[:-6], "x.csv.gz"))
    assert "holds no channels of numbers" in refusal(write(tmp_path, b"nonsense", "x.tdms"))
    for ending in ("xlsx", "ulg", "h5"):
        assert f"not a readable .{ending} file" in refusal(write(tmp_path, b"nonsense", f"x.{ending}"))


def test_logs_and_spreadsheets_are_read_by_their_libraries(tmp_path):
    TABLE.to_excel(tmp_path / "x.xlsx", index=False)
    with h5py.File(tmp_path / "x.h5", "w") as file:
        for name in TABLE:
            file[f"log/{name}"] = TABLE[name].to_numpy()
        file["log/rate"].attrs["unit"], file["log/once"] = "deg/h", [1.0]
    with nptdms.TdmsWriter(tmp_path / "x.tdms") as writer:
        timing = {"wf_start_offset": 0.0, "wf_increment": 60.0}
        writer.write_segment([
            nptdms.ChannelObject("log", name, TABLE[name].to_numpy(), {**timing, "unit_string": unit})
            for name, unit in (("rate", "deg/h"), ("temperature", "degC"))
        ])  # fmt: skip
    for ending in ("xlsx", "h5", "tdms"):
        plan = imported(tmp_path / f"x.{ending}")
        np.testing.assert_array_equal(plan.time, TABLE["time"])
        np.testing.assert_array_equal(plan.channels["rate"], TABLE["rate"])
        np.testing.assert_array_equal(plan.channels["temperature"], TABLE["temperature"])


def test_a_flight_log_is_read_topic_by_topic(tmp_path):
    """ULog: https://docs.px4.io/main/en/dev_log/ulog_file_format.html, written here byte by byte."""

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<H", len(content)) + kind + content

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    data += message(b"F", b"imu:uint64_t timestamp;float gyro;float temperature;")
    data += message(b"A", struct.pack("<BH", 0, 0) + b"imu")
    for row in TABLE.fillna(0.0).itertuples():
        values = struct.pack("<Qff", int(1e6 * row.time), row.rate, row.temperature)
        data += message(b"D", struct.pack("<H", 0) + values)
    columns = ColumnMap(rate=ChannelSource(column="imu.gyro", unit="deg/h"))
    plan = imported(write(tmp_path, data, "x.ulg"), columns)
    np.testing.assert_array_equal(plan.channels["rate"], TABLE["rate"].fillna(0.0))
    np.testing.assert_array_equal(plan.time, TABLE["time"])


def test_parquet_keeps_gaps_types_and_units_of_its_fields(tmp_path):
    fields = [pa.field("time", pa.timestamp("ms")), pa.field("gyro", pa.float32(), metadata={"unit": "mdps"}),
              pa.field("temperature", pa.int16()), pa.field("compressor", pa.bool_()),
              pa.field("note", pa.string())]  # fmt: skip
    arrays = [[0, 500, 1000], [1.0, None, 2.0], [20, 21, 22], [True, False, True], ["a", "b", "c"]]
    table = pa.Table.from_arrays(
        [pa.array(a, f.type) for a, f in zip(arrays, fields, strict=True)], schema=pa.schema(fields)
    )
    pq.write_table(table, tmp_path / "x.parquet")
    plan = imported(tmp_path / "x.parquet")
    assert plan.time.tolist() == [0, 0.5, 1]
    np.testing.assert_allclose(plan.channels["rate"], [3.6, np.nan, 7.2])
    assert plan.channels["compressor"].tolist() == [1, 0, 1]
    assert "not used             note" in plan.preview()


def test_a_can_log_is_decoded_with_its_dbc_and_stays_sparse(tmp_path):
    layout = cantools.database.load_file(DBC)
    res, rate = layout.get_message_by_name("GYRO_RES"), layout.get_message_by_name("GYRO_RATE")
    zero = {signal.name: 0 for signal in (*res.signals, *rate.signals)}
    slow = {"Temperature": 25.0, "ResonanceFrequency": 14000.0}
    path = tmp_path / "log.asc"
    with can.Logger(str(path)) as log:
        for i in range(100):
            values = {s.name: zero[s.name] for s in rate.signals} | {"Rate": 0.001 * i}
            log.on_message_received(can.Message(1000 + i * 0.002, rate.frame_id, False, data=rate.encode(values)))
            if i % 10 == 0:
                values = {s.name: zero[s.name] for s in res.signals} | slow
                log.on_message_received(can.Message(1000.001 + i * 0.002, res.frame_id, False, data=res.encode(values)))
        log.on_message_received(can.Message(1001, 0x7FF, False, data=b"x"))
    plan = imported(path, dbc=DBC)
    known = np.isfinite(plan.channels["rate"])
    np.testing.assert_allclose(plan.channels["rate"][known], 3.6 * np.arange(100), atol=0.004)
    assert np.count_nonzero(np.isfinite(plan.channels["temperature"])) == 10
    assert plan.channels["frequency"][np.isfinite(plan.channels["frequency"])] == pytest.approx(14000)
    assert "1 frames are not described by the DBC" in plan.warnings[0]
    assert "not a readable DBC" in refusal_of_dbc(path, tmp_path)


def test_multiplexed_and_long_frames_of_a_can_log_are_read(tmp_path):
    dbc = write(
        tmp_path,
        'VERSION ""\nBU_: A\nBO_ 1 M: 12 A\n SG_ Which M : 0|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ Warm m0 : 63|16@0- (0.5,0) [0|0] "degC" A\n SG_ Volts m1 : 68|16@1+ (0.001,0) [0|0] "V" A\n'
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","StandardCAN_FD";\nBA_ "VFrameFormat" BO_ 1 1;\n',
        "mux.dbc",
    )
    path = tmp_path / "log.blf"
    with can.Logger(str(path)) as log:
        for k, raw in enumerate((b"\xff\xce", b"\x80\x3e", b"\x00\x32")):
            data = bytes([k % 2, *bytes(6), *(raw if k % 2 == 0 else b"\0\x80"), 0x3E * (k % 2), 0, 0])
            log.on_message_received(can.Message(1000 + k, 1, False, is_fd=True, data=data))
    table = read_table(path, dbc)
    np.testing.assert_array_equal(table.columns["Warm"], [-25.0, np.nan, 25.0])
    np.testing.assert_allclose(table.columns["Volts"], [np.nan, 0x3E8 * 1e-3, np.nan])
    assert table.units == {"time": "s", "Warm": "degC", "Volts": "V"}


def test_a_can_log_is_decoded_in_one_block_per_message(tmp_path, monkeypatch):
    calls = []
    decode = Message.decode
    monkeypatch.setattr(Message, "decode", lambda self, data: calls.append(data.shape) or decode(self, data))
    path = tmp_path / "log.asc"
    with can.Logger(str(path)) as log:
        for k in range(500):
            log.on_message_received(can.Message(1000 + 0.002 * k, 0x120, False, data=bytes(8)))
    read_table(path, DBC)
    assert calls == [(500, 8)]


def refusal_of_dbc(path, tmp_path):
    with pytest.raises(InputError) as caught:
        imported(path, dbc=write(tmp_path, "nonsense", "bad.dbc"))
    return str(caught.value)


def written_tdms(path, begin):
    timing = {"wf_start_offset": 0.0, "wf_increment": 60.0, "wf_start_time": begin.replace(tzinfo=None)}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([
            nptdms.ChannelObject("log", name, TABLE[name].to_numpy(), {**timing, "unit_string": unit})
            for name, unit in (("rate", "deg/h"), ("temperature", "degC"))
        ])  # fmt: skip


def written_mf4(path, begin):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF() as file:
        file.start_time = begin
        seconds = TABLE["time"].to_numpy(float)
        pairs = (("rate", "deg/h"), ("temperature", "degC"))
        file.append(
            [asammdf.Signal(TABLE[name].to_numpy(float), seconds, name=name, unit=unit) for name, unit in pairs]
        )
        file.save(path)


def written_parquet(path, begin):
    moments = begin + pd.to_timedelta(TABLE["time"], "s")
    named = {"rate": "rate [deg/h]", "temperature": "temperature [degC]"}
    TABLE.rename(columns=named).assign(time=moments).to_parquet(path)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("write", [written_mf4, written_tdms, written_parquet], ids=lambda write: write.__name__[8:])
def test_a_binary_log_keeps_its_first_moment_which_is_no_warning(tmp_path, write):
    path = tmp_path / f"x.{write.__name__[8:]}"
    write(path, datetime(2026, 11, 20, 23, 59, 50, tzinfo=UTC))
    plan = imported(path)
    begin = "'time' begins at 2026-11-20 23:59:50+00:00"
    assert begin in plan.warnings
    assert begin not in plan.doubts


def test_a_log_of_a_clock_that_was_never_set_has_no_first_moment(tmp_path):
    written_tdms(tmp_path / "x.tdms", datetime(1970, 1, 1, tzinfo=UTC))
    assert not [text for text in imported(tmp_path / "x.tdms").warnings if "begins at" in text]


@pytest.mark.parametrize(("since", "begins"), [(1_795_000_000, True), (1000, False)])
def test_a_can_log_keeps_the_first_moment_of_its_frames(tmp_path, since, begins):
    with can.Logger(str(tmp_path / "log.blf")) as log:
        for k in range(5):
            log.on_message_received(can.Message(since + k, 0x120, False, data=bytes(8)))
    notes = read_table(tmp_path / "log.blf", DBC).notes
    assert (f"'time' begins at {datetime.fromtimestamp(since, UTC).isoformat(' ')}" in notes) == begins


@pytest.mark.filterwarnings("ignore")
def test_mf4_is_read_with_its_units(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    file = asammdf.MDF()
    fast, slow = np.arange(0, 10, 0.1), np.arange(0, 10, 1.0)
    file.append([asammdf.Signal(np.sin(fast), fast, name="Gyro", unit="deg/s")])
    file.append([asammdf.Signal(20 + slow, slow, name="Temperature", unit="°C")])
    file.save(tmp_path / "x.mf4")
    file.close()
    plan = imported(tmp_path / "x.mf4")
    np.testing.assert_allclose(plan.channels["rate"], 3600 * np.sin(fast), rtol=1e-12)
    assert np.count_nonzero(np.isfinite(plan.channels["temperature"])) == 10
