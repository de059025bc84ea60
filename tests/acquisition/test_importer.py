"""Foreign tables: read exactly, converted by pint's units, cut into branches, or refused with file and line."""

import gzip
import io
import struct
import subprocess
import sys
import zipfile
from decimal import Decimal
from pathlib import Path

import can
import cantools
import h5py
import nptdms
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.acquisition.importer.branches import find_branches, segment_of
from bench.acquisition.importer.columns import ChannelSource, ColumnMap, TimeSource, split_header
from bench.acquisition.importer.plan import load_columns, plan_import, plan_table, write_import
from bench.acquisition.importer.tables import read_table
from bench.acquisition.importer.units import conversion
from bench.base import load_config, parse_yaml
from bench.base.errors import InputError
from bench.record import apart, dataset, load, read_samples
from bench.record.folder import open_run
from drivers.wire import Message

DBC = Path(__file__).parents[2] / "drivers" / "gyros" / "vibratory.dbc"
COUNTED = ColumnMap(time=TimeSource(interval_s=1.0))


def write(tmp_path, text, name="table.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def refusal(path, columns=None, **options):
    with pytest.raises(InputError) as caught:
        plan_import(path, columns, **options)
    text = str(caught.value)
    assert "\n" not in text, "one clear line"
    assert str(path) in text
    return text.replace(str(path), "FILE")


def loop(rows=1200, seconds=20.0):
    """A record 25 → -20 → 60 → 25 degC with a stand of an hour at the cold end: time, rate, temperature."""
    time = np.arange(rows) * seconds
    degc = np.interp(time, [0, 5000, 8600, 16000, 24000], [25, -20, -20, 60, 25])
    return time, 10 + 0.1 * degc, degc


# Reading ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_a_table_is_read_with_any_usual_delimiter_comments_and_a_byte_order_mark(tmp_path, delimiter):
    rows = [["time_s", "rate_dph", "temp_C"], ["0", "1.5", "20"], ["1", "-2e0", "21"], ["2", "nan", "22"]]
    body = "\n".join(delimiter.join(row) for row in rows)
    plan = plan_import(write(tmp_path, f"\ufeff# made by us\n\n{body}\n"))
    assert plan.time.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(plan.channels["rate"], [1.5, -2, np.nan])
    assert plan.channels["temperature"].tolist() == [20, 21, 22]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Logger: A7\nSerial: 12\n\ntime,rate,temperature\n0,1,20\n1,fault,20\n", "FILE:6: 'rate' is 'fault'"),
        ("time,rate,temperature\ns,deg/s,degC\n0,1,20\n1,fault,20\n", "FILE:4: 'rate' is 'fault'"),
        (
            "time,rate,temperature\nshut,open,shut\n0,1,20\n1,1,20\n",
            "FILE:2: holds no column of numbers: 'time' is 'shut'",
        ),
        ("time,rate,temperature\ns,grad/s,degC\n0,1,20\n1,1,20\n", "FILE: 'grad/s' has two meanings"),
        ("time,rate,temperature,\n0,1,20,\n1,1,20,7\n", "FILE:1: column 4 has no name"),
        ("time,rate,temperature\n0,1\n1,1,20\nwarm,cold,mild\n", "FILE:2: has 2 fields, the header 3; delete lines"),
        ("sep=|\ntime,rate,temperature\n0,1,20\n", "FILE:2: has one column"),
    ],
)
def test_lines_are_counted_from_the_first_whatever_stands_before_the_table(tmp_path, text, message):
    assert refusal(write(tmp_path, text)).startswith(message)


def test_the_units_of_a_header_stand_before_those_below_it(tmp_path):
    plan = plan_import(write(tmp_path, "time,rate [deg/h],temperature\nmin,deg/s,degC\n0,1,20\n1,1,20\n"))
    assert plan.time.tolist() == [0, 60]
    assert plan.channels["rate"].tolist() == [1, 1]
    assert "line 2 was read as the units of the columns" in plan.warnings


def test_a_quoted_header_may_hold_the_delimiter(tmp_path):
    plan = plan_import(write(tmp_path, '"time (s)","rate [deg/s]","T, inner"\n0,1,20\n1,1,21\n'),
                       ColumnMap(temperature=ChannelSource(column="T, inner", unit="degC")))  # fmt: skip
    assert plan.channels["rate"].tolist() == [3600, 3600]


ROWS = "{0},1,20\n{1},-1,21\n{2},1,22\n"
NUMBERED = "time,rate [deg/h],temp [degC]\n" + ROWS.format(0, 1, 2)


def spreadsheet(rows):
    file = io.BytesIO()
    pd.DataFrame(rows).to_excel(file, index=False, header=False)
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("din.csv", "Zeit/s;Drehrate/°/h;Temp./°C\n0;1;20\n1;-1;21\n2;1;22\n".encode("cp1252")),
        ("words.csv", "Zeit in s,rate in deg/h,temperature in K\n0,1,293.15\n1,-1,294.15\n2,1,295.15\n"),
        ("capitals.csv", "TIME [S],RATE [DEG/S],TEMP [Deg C]\n" + ROWS.format(0, 1, 2)),
        ("lines_of_old_programs.csv", NUMBERED.replace("\n", "\r")),
        ("no_mark.txt", NUMBERED.encode("utf-16-le")),
        ("typeset.csv", NUMBERED.replace("-", "\N{MINUS SIGN}")),
        ("iso_basic.csv", NUMBERED[:30] + ROWS.format("20261120T235959Z", "20261121T000000Z", "20261121T000001Z")),
        ("merged.xlsx", spreadsheet([["Test of G-7", None, None], ["clock", "gyro", None],
                                     ["time [s]", "rate [deg/h]", "temp [degC]"], [0, 1, 20], [1, -1, 21],
                                     [2, 1, 22]])),
        ("units.xlsx", spreadsheet([["time", "rate", "temp"], ["s", "deg/h", "degC"], [0, 1, 20], [1, -1, 21],
                                    [2, "1,0", 22]])),
        ("beside.xlsx", spreadsheet([[None, "time", "rate [deg/h]", "temp [degC]"], [None, 0, 1, 20],
                                     [None, 1, -1, 21], [None, 2, 1, 22], [None] * 4])),
    ],
)  # fmt: skip
def test_a_table_of_a_laboratory_is_read_as_it_is_written(tmp_path, name, content):
    plan = plan_import(write(tmp_path, content, name))
    assert plan.time.tolist() == [0, 1, 2]
    factor = 3600 if name == "capitals.csv" else 1
    assert (plan.channels["rate"] / factor).tolist() == [1, -1, 1]
    np.testing.assert_allclose(plan.channels["temperature"], [20, 21, 22], atol=1e-9)


@pytest.mark.parametrize(
    "header",
    [
        "Час, с;Кутова швидкість, °/с;Температура, °C",
        "Время, с;Угловая скорость, град/с;Температура, °С",
        "时间(s);角速度(°/s);温度(℃)",
        "时间（秒）;角速度［度/秒］;温度（℃）",
        "time (s);rate (deg s-1);temp (degC)",
        "t, s;gyro, deg*s^-1;temperature, K",
        "t/s;gyro [°·s⁻¹];T/°C",
    ],
)
def test_names_and_units_of_other_languages_are_read_like_english_ones(tmp_path, header):
    kelvin = 273.15 if header.endswith("K") else 0.0
    rows = "".join(f"{t};{1e-3 * t:.3f};{20 + t + kelvin}\n" for t in range(3))
    plan = plan_import(write(tmp_path, f"{header}\n{rows}"))
    assert plan.time.tolist() == [0, 1, 2]
    np.testing.assert_allclose(plan.channels["rate"], [0, 3.6, 7.2], atol=1e-9)
    np.testing.assert_allclose(plan.channels["temperature"], [20, 21, 22], atol=1e-9)


def test_a_zip_archive_with_one_table_is_read_and_one_with_several_names_them(tmp_path):
    path = tmp_path / "log.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("out/", "")
        archive.writestr("out/log.csv", "time,rate [deg/h],temp [degC]\n0,1,20\n1,2,21\n")
    assert plan_import(path).channels["rate"].tolist() == [1, 2]
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("out/other.csv", "")
    assert "is a zip archive of 2 files: out/log.csv, out/other.csv; " in refusal(path)
    path.write_bytes(path.read_bytes()[:100])
    assert "not a readable zip file" in refusal(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("root.csv", NUMBERED.replace("deg/h", "°/√h"), "FILE: '°/√h' is not a unit that is known; rate may be in"),
        ("sensitivity.csv", NUMBERED.replace("deg/h", "mV/(deg/s)"), "FILE: 'mV/(deg/s)' does not measure rate"),
        ("cyrillic.csv", ("прибор 7\n" + NUMBERED).encode("cp1251"),
         "FILE:1: is not UTF-8: 'прибор' as cp1251, 'ïðèáîð' as cp1252, '镳栳铕' as gb18030; state which one by"),
        ("binary.csv", NUMBERED.encode() + b"\x98\x81\xff,1,2\n", "FILE:5: is not UTF-8 and in none of cp1251, "),
        ("packed.csv", b"PK\x03\x04" + bytes(40), "FILE: not a readable zip file ("),
        ("zone.csv", NUMBERED.replace("\n0", "\n2026-10-25 01:30:00 CEST"),
         "FILE:2: 'time' is '2026-10-25 01:30:00 CEST', no time as it is known; export times as 2026-01-31T14:00"),
        ("nbsp.csv", NUMBERED.replace(",", ";").replace(";20", ";1\xa0020,5"),
         "FILE:2: 'temp [degC]' is '1 020,5', not a number: separators of thousands?"),
        ("no_time.csv", NUMBERED.replace("time", "Datum"),
         "FILE: no column is time; the table has Datum, rate [deg/h], "),
        ("two.csv", NUMBERED + ROWS.format(0, 1, 2),
         "FILE:5: time runs backwards: 'time' is 0 after 2; two records or two"),
    ],
)  # fmt: skip
def test_a_table_that_cannot_be_read_as_it_is_says_what_to_do(tmp_path, name, content, message):
    assert refusal(write(tmp_path, content, name)).replace("\xa0", " ").startswith(message)


@pytest.mark.parametrize(
    ("encoding", "header"),
    [
        ("cp1251", "Час, с;Кутова швидкість, °/с;Температура, °C"),
        ("cp1251", "Время, с;Угловая скорость, °/с;Температура, °C"),
        ("gb18030", "时间(s);角速度(°/s);温度(℃)"),
        ("gbk", "时间（s）;角速度（°/s）;温度（℃）"),
        ("gbk", "time [s];rate [°/s];temp [℃]"),
        ("big5", "時間(s);角速度(°/s);溫度(℃)"),
        ("koi8-u", "Час, с;Кутова швидкість, °/с;Температура, °C"),
    ],
)
def test_a_table_in_the_encoding_of_its_country_is_read(tmp_path, encoding, header):
    path = write(tmp_path, f"{header}\n0;1,5;20\n1;-2,5;21\n2;1;22\n".encode(encoding), "table.csv")
    stated = encoding in ("big5", "koi8-u")
    columns = load_config(parse_yaml(f"encoding: {encoding}\n", "c.yaml"), ColumnMap) if stated else None
    table = read_table(path, encoding=columns and columns.encoding)
    plan = plan_table(table, columns or ColumnMap(), "G-1")
    assert plan.channels["rate"].tolist() == [5400.0, -9000.0, 3600.0]
    assert stated or any(note.endswith(f"was read as {table.encoding}") for note in table.notes)
    run = write_import(plan, tmp_path / "out")
    again = load_columns(run.path / "columns.yaml")
    assert again.encoding == table.encoding
    assert plan_table(read_table(path, encoding=again.encoding), again, "G-1").time.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("encoding", "said"),
    [("cp1521", "c.yaml:1: encoding: 'cp1521' is no encoding; cp1251, cp1252, gb18030, big5, shift_jis"),
     ("base64", "c.yaml:1: encoding: 'base64' is no encoding; ")],
)  # fmt: skip
def test_an_encoding_that_there_is_not_is_refused(encoding, said):
    with pytest.raises(InputError) as refused:
        load_config(parse_yaml(f"encoding: {encoding}\n", "c.yaml"), ColumnMap)
    assert str(refused.value).startswith(said)


def test_a_table_in_another_encoding_than_stated_is_refused_with_its_line(tmp_path):
    path = write(tmp_path, NUMBERED.encode() + "3,1,温度\n".encode("gbk"), "table.csv")
    with pytest.raises(InputError) as refused:
        read_table(path, encoding="utf-8")
    assert str(refused.value) == f"{path}:5: is not text in utf-8, as stated by `encoding`; correct it or leave it out"


def test_times_of_day_beside_dates_count_the_days_between(tmp_path):
    moments = ("2026-11-20,23:59:50", "2026-11-21,00:00:00", "2026-11-23,08:00:00", "2026-11-23,08:00:10")
    rows = "".join(f"{moment},1,20\n" for moment in moments)
    plan = plan_import(write(tmp_path, f"date,clock,rate [deg/h],temp [degC]\n{rows}"))
    assert plan.time.tolist() == [0, 10, 201_610, 201_620]


def test_what_instruments_measured_is_imported_where_its_unit_is_stated(tmp_path):
    rows = "".join(f"{i},1,2{i},4{i},29{i}.15,150,7\n" for i in range(3))
    head = "time,rate [deg/h],temp [degC],humidity [%],Reference temperature [K],supply current [mA],pressure\n"
    plan = plan_import(write(tmp_path, head + rows))
    assert {*plan.channels} - {"rate", "temperature"} == {"humidity", "reference_temperature", "supply_current"}
    np.testing.assert_allclose(plan.channels["reference_temperature"], [16.0 + i + 1 for i in range(3)])
    np.testing.assert_allclose(plan.channels["supply_current"], 0.15)
    columns = ColumnMap(pressure=ChannelSource(column="pressure", unit="kPa"))
    assert plan_import(write(tmp_path, head + rows), columns).channels["pressure"].tolist() == [70, 70, 70]


def test_durations_and_decimals_of_parquet_are_numbers_and_texts_are_named(tmp_path):
    path, frame = tmp_path / "odd.parquet", pd.DataFrame({"rate": [1.0, 2.0], "temperature": [20.0, 21.0]})
    frame.assign(time=pd.to_timedelta([0, 10], unit="s"), rate=[Decimal("1.5"), Decimal("2.5")]).to_parquet(path)
    plan = plan_import(path)
    assert (plan.time.tolist(), plan.channels["rate"].tolist()) == ([0, 10], [1.5, 2.5])
    frame.assign(time=[0, 1], rate=["1.5", "2.5"]).to_parquet(path)
    assert "column 'rate' holds" in refusal(path)


def test_comments_and_blank_lines_between_rows_keep_the_line_numbers(tmp_path):
    text = "# one\r\ntime,rate,temperature\r\n0,1,20\r\n\r\n# stop\r\n2,1,20\r\n1.9,1,20\r\n"
    assert refusal(write(tmp_path, text)).startswith("FILE:7: time runs backwards")
    assert plan_import(write(tmp_path, text.replace("\n1.9,1", "\n3,1"))).time.tolist() == [0, 2, 3]


def test_numbers_are_read_to_the_last_digit(tmp_path):
    values = np.random.default_rng(1).normal(14000, 1, 50)
    body = "\n".join(f"{i},{value!r},20" for i, value in enumerate(values.tolist()))
    plan = plan_import(write(tmp_path, f"time,rate,temperature\n{body}\n"))
    np.testing.assert_array_equal(plan.channels["rate"], values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "FILE: is empty"),
        ("# only a comment\n\n", "FILE: has no table"),
        ("time,rate,temperature\n", "FILE: holds zero rows"),
        ("0,1,20\n1,1,21\n", "FILE:1: the first line holds numbers, not names"),
        ("time\n1\n2\n", "FILE:1: has one column"),
        ("time,rate,rate\n0,1,1\n", "FILE:1: the header names 'rate' twice"),
        ("time,rate,\n0,1,1\n", "FILE:1: column 3 has no name"),
        ("time,rate,temperature\n0,1,20\n1,1,2", ""),
        ("time,rate,temperature\n0,1,20\n1,1", "FILE:3: has 2 fields, the header 3: the file is truncated"),
        ("time,rate,temperature\n0,1\n1,1,20\n", "FILE:2: has 2 fields, the header 3"),
        ("time,rate,temperature\n0,1,5,1,20,5,3\n1,1,20\n", "FILE:2: has 7 fields"),
        ("time,rate,temperature\n0,5,1,5,20,5\n1,5,1,5,20,5\n", "FILE:2: has 6 fields, the header 3: decimal commas?"),
        ("time;rate;temperature\n0;1,5;20\n1;1.5;20\n", "FILE:2: 'rate' is '1,5', not a number: decimal commas in"),
        ("time;rate;temperature\n03/04/2026 10:00;1;20\n03/05/2026 10:01;1;20\n",
         "FILE:2: 'time' is '03/04/2026 10:00': the day or the month first?"),
        ("time,rate [grad/s],temperature\n0,1,20\n1,1,20\n", "FILE: 'grad/s' has two meanings: degree, or gon"),
        ("# x\ntime,rate,temperature\n0,1,20\n1,fault,20\n", "FILE:4: 'rate' is 'fault', not a number"),
        ("time,rate,temperature\n0,١٢٣,20\n1,1,20\n", "FILE:2: 'rate' is '١٢٣', not a number"),
        ("time,rate,temperature\n0,1,20\n1,inf,20\n", "FILE:3: 'rate' is infinite"),
        ("time,rate,temperature\n0,1,20\n", "FILE: holds one row"),
        ("time,rate,temperature\n0,1,20\n5,1,20\n4,1,20\n", "FILE:4: time runs backwards: 'time' is 4 after 5"),
        ("time,rate,temperature\n2026-10-25 02:00:00,1,20\n2026-10-25 02:59:00,1,20\n2026-10-25 02:00:00,1,20\n"
         "2026-10-25 02:59:00,1,20\n", "FILE:4: time runs backwards: 'time' is 0 after 3540; is it the end of summer"),
        ("time,rate,temperature\n0,1,20\n1,1,20\n1,1,20\n", "FILE:4: time stands still: 'time' is 1 after 1"),
        ("time,rate,temperature\n0,1,20\n,1,20\n", "FILE:3: 'time' (time) has no value"),
        ("time,rate,temperature\n0,,20\n1,,20\n", "FILE: column 'rate' (rate) has no value in any row"),
        ("time,volts,temperature\n0,1,20\n1,1,20\n", "FILE: no column is rate; the table has time, volts, temperature"),
        ("time,gx_dph,gy_dph,temp_C\n0,1,1,20\n1,1,1,20\n", "FILE: several columns could be rate: gx_dph, gy_dph"),
        ("time,gz,temp_C\n0,1,20\n1,1,20\n", "FILE: 'gz' does not say its unit"),
        ("sample,rate,temperature\n0,1,20\n1,1,20\n", "FILE: 'sample' counts samples, and nothing says how long"),
        ("rate,temperature\n1,20\n1,20\n", "FILE: no column is time"),
        ("time,rate [Hz],temperature\n0,1,20\n1,1,20\n", "FILE: 'Hz' does not measure rate"),
    ],
)  # fmt: skip
def test_what_cannot_become_a_run_is_refused_in_one_line(tmp_path, text, message):
    path = write(tmp_path, text)
    if message:
        assert refusal(path).startswith(message)
    else:
        assert "its last number may be cut off" in plan_import(path).warnings[0]


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


TABLE = pd.DataFrame({"time": [0.0, 60.0, 120.0], "rate": [1.5, -2.25, np.nan], "temperature": [20.0, 21.5, 22.0]})


@pytest.mark.parametrize(
    "text",
    [
        "time;rate;temperature\n0;1,5;20\n60;-2,25;21,5\n120;;22\n",
        "time [min];rate;temperature;state\n0;1,5;20;ok\n1;-2,25;21,5;ok\n2;;22;fault, 7\n",
        "\ufefftime,rate,temperature\n2026-11-22T10:00:00Z,1.5,20\n2026-11-22T11:01:00+01:00,-2.25,21.5\n"
        "2026-11-22T10:02:00Z,,22\n",
        "time,rate,temperature\n2026-11-22 10:00:00,1.5,20\n2026-11-22 10:01:00.000,-2.25,21.5\n"
        "2026-11-22 10:02:00,,22\n",
        "time;rate;temperature\n22.11.2026 23:59:00;1,5;20\n23.11.2026 00:00:00;-2,25;21,5\n23.11.2026 00:01:00;;22\n",
        "time,rate,temperature\n11/22/2026 11:59 PM,1.5,20\n11/23/2026 12:00 AM,-2.25,21.5\n11/23/2026 12:01 AM,,22\n",
        "time,rate,temperature\n23:59:00,1.5,20\n00:00:00,-2.25,21.5\n00:01:00.0,,22\n",
        "time,rate,temperature\n120,,22\n0,1.5,20\n60,-2.25,21.5\n",
        'time,rate,"temperature"\n0,1.5,"20"\n60,-2.25,"21.5"\n120,NaN,"22"\n',
    ],
)  # fmt: skip
@pytest.mark.parametrize("way", ["utf-8", "utf-16", "cp1252", "gzip"])
def test_a_table_is_read_as_laboratories_write_it(tmp_path, text, way):
    header, body = text.removeprefix("\ufeff").split("\n", 1)
    text = f"{header.replace('temperature', 'temperature [°C]')}\n{body}"
    path = tmp_path / ("table.csv.gz" if way == "gzip" else "table.csv")
    path.write_bytes(gzip.compress(text.encode()) if way == "gzip" else text.encode(way))
    plan = plan_import(path)
    np.testing.assert_array_equal(plan.time, TABLE["time"])
    np.testing.assert_array_equal(plan.channels["rate"], TABLE["rate"])
    np.testing.assert_array_equal(plan.channels["temperature"], TABLE["temperature"])


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
        plan = plan_import(tmp_path / f"x.{ending}")
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
    plan = plan_import(write(tmp_path, data, "x.ulg"), columns)
    np.testing.assert_array_equal(plan.channels["rate"], TABLE["rate"].fillna(0.0))
    np.testing.assert_array_equal(plan.time, TABLE["time"])


def test_a_text_column_is_an_error_only_where_it_is_wanted(tmp_path):
    path = write(tmp_path, "time,rate,temperature,note\n0,1,20,warm\n1,1,20,\n2,oops,20,\n")
    assert refusal(path).startswith("FILE:4: 'rate' is 'oops', not a number")
    plan = plan_import(write(tmp_path, "time,rate,temperature,note\n0,1,20,warm\n1,1,20,\n2,1,20,\n"))
    assert "not used             note" in plan.preview()


# Units and columns ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channel", "unit", "given", "expected"),
    [
        ("rate", "deg/h", 2.0, 2.0), ("rate", "deg/s", 1.0, 3600.0), ("rate", "dps", 1.0, 3600.0),
        ("rate", "mdps", 1.0, 3.6), ("rate", "rad/s", 1.0, 3600 * 180 / np.pi),
        ("rate", "mrad/s", 1.0, 3.6 * 180 / np.pi),
        ("rate", "arcsec/s", 1.0, 1.0), ("rate", "°/h", 5.0, 5.0), ("rate", "rpm", 1.0, 21600.0),
        ("temperature", "K", 273.15, 0.0), ("temperature", "degF", 212.0, 100.0), ("temperature", "F", -40.0, -40.0),
        ("temperature", "°C", 5.0, 5.0), ("temperature", "C", 5.0, 5.0),
        ("frequency", "kHz", 14.0, 14000.0), ("drive", "mV", 5.0, 0.005), ("time", "ms", 5.0, 0.005),
        ("applied_rate", "rad/s", np.pi, 180.0),
    ],
)  # fmt: skip
def test_units_are_converted(channel, unit, given, expected):
    assert conversion(unit, channel)(np.array([given]))[0] == pytest.approx(expected, rel=1e-14, abs=1e-9)


@pytest.mark.parametrize(("channel", "unit"), [("rate", "Hz"), ("rate", "degC"), ("temperature", "V"), ("rate", "(("),
                                               ("frequency", "mhz"), ("rate", "1/s"), ("time", "m"),
                                               ("time", "\ufeff"), ("time", "\n"), ("rate", "(" * 3000)])  # fmt: skip
def test_units_of_something_else_are_refused(channel, unit):
    with pytest.raises(InputError, match=r"may be in"):
        conversion(unit, channel)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("gx_dph", ("gx", "dph")), ("rate [deg/s]", ("rate", "deg/s")), ("T (°C)", ("T", "°C")),
        ("temp_degC", ("temp", "degC")), ("rate_deg_h", ("rate", "deg_h")), ("time_ms", ("time", "ms")),
        ("chamber_temperature", ("chamber_temperature", None)), ("t", ("t", None)), ("quad_mV", ("quad", "mV")),
    ],
)  # fmt: skip
def test_headers_are_split_into_name_and_unit(header, expected):
    assert split_header(header) == expected


def test_a_column_map_chooses_columns_and_units(tmp_path):
    path = write(tmp_path, "n,gx,gz,case\n10,1,0.5,300\n11,1,0.5,301\n14,1,0.5,302\n")
    map_path = write(tmp_path, "time: {column: n, rate_hz: 50}\nrate: {column: gz, unit: deg/s}\n"
                               "temperature: {column: case, unit: K}\n", "map.yaml")  # fmt: skip
    plan = plan_import(path, load_columns(map_path))
    np.testing.assert_allclose(plan.time, [0, 0.02, 0.08])
    np.testing.assert_allclose(plan.channels["rate"], 1800)
    np.testing.assert_allclose(plan.channels["temperature"], [26.85, 27.85, 28.85])
    assert "not used             gx" in plan.preview()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rat: {column: x}", r":1: unknown key 'rat'; did you mean 'rate'\?"),
        ("time: {column: t, unit: s, rate_hz: 3}", "give one of unit"),
        ("time: {}", "give a column of times"),
        ("time: {interval_s: 0}", "must be greater than 0"),
    ],
)
def test_a_wrong_column_map_is_refused_with_its_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        load_columns(write(tmp_path, text, "map.yaml"))


def test_a_column_that_does_not_exist_names_the_nearest(tmp_path):
    path = write(tmp_path, "time,gyro_out,temperature\n0,1,20\n1,1,21\n")
    text = refusal(path, ColumnMap(rate=ChannelSource(column="gyro_ou", unit="deg/h")))
    assert "column 'gyro_ou' for rate does not exist; did you mean 'gyro_out'?" in text


# Doubts -----------------------------------------------------------------------------------------------------------


def doubts(tmp_path, rate, degc, columns=COUNTED):
    body = "\n".join(f"{r!r},{t!r}" for r, t in zip(rate.tolist(), degc.tolist(), strict=True))
    return plan_import(write(tmp_path, f"rate,temperature\n{body}\n"), columns).warnings


def test_a_rate_in_another_unit_is_doubted_by_its_magnitude(tmp_path):
    noise, degc = np.random.default_rng(2).normal(5, 3, 500), np.linspace(0, 50, 500)
    assert doubts(tmp_path, noise, degc) == ()
    assert "check the unit" in doubts(tmp_path, noise / 3600, degc)[0]
    assert "check the unit" in doubts(tmp_path, noise / 206265, degc)[0]
    as_rad = ColumnMap(time=TimeSource(interval_s=1), rate=ChannelSource(column="rate", unit="rad/s"))
    assert "more than any gyro measures" in doubts(tmp_path, noise * 1000, degc, as_rad)[0]


def test_doubtful_temperatures_are_warned_of(tmp_path):
    rate = np.random.default_rng(3).normal(5, 3, 500)
    assert "check the unit (K, degF?)" in doubts(tmp_path, rate, np.linspace(250, 320, 500))[0]
    assert "temperature is constant" in doubts(tmp_path, rate, np.full(500, 25.0))[0]
    assert "steps of 1 degC" in doubts(tmp_path, rate, np.round(np.linspace(0, 50, 500)))[0]


def test_gaps_in_time_are_counted_and_stay_gaps(tmp_path):
    body = "".join(f"{t},{t % 3},{20 + t / 10}\n" for t in [*range(50), *range(500, 550)])
    plan = plan_import(write(tmp_path, "time,rate,temperature\n" + body))
    assert plan.warnings[0].startswith("1 gaps in time, together 451 s, the first before line 52")
    assert plan.time.size == 100


# Branches ---------------------------------------------------------------------------------------------------------


def test_branches_follow_the_temperature():
    time, _, degc = loop()
    noisy = degc + np.random.default_rng(4).normal(0, 0.2, degc.size)
    found = find_branches(time, noisy)
    assert [branch.direction for branch in found] == ["cooling", "constant", "heating", "cooling"]
    np.testing.assert_allclose([branch.from_s for branch in found], [0, 5000, 8600, 16000], atol=200)
    assert found[0].rate_degc_per_min == pytest.approx(45 / 5000 * 60, rel=0.05)
    assert found[-1].to_s == time[-1]
    segment = segment_of(found, time)
    assert segment[0] == 0
    assert segment[-1] == 3
    assert np.all(np.diff(segment) >= 0)


def test_a_minor_loop_makes_branches_and_noise_does_not():
    time = np.arange(0, 12000, 1.0)
    degc = np.interp(time, [0, 4000, 6000, 8000, 12000], [85, 0, 50, 20, 25])
    directions = [branch.direction for branch in find_branches(time, degc)]
    assert directions[:3] == ["cooling", "heating", "cooling"]
    flat = 25 + np.random.default_rng(5).normal(0, 0.05, 5000)
    assert [branch.direction for branch in find_branches(np.arange(5000.0), flat)] == ["constant"]


def test_branches_of_a_lagging_unit_keep_their_soaks():
    time = np.arange(0, 30000, 10.0)
    air = np.interp(time, [0, 3000, 9000, 13000, 20000, 23000, 30000], [25, -30, -30, 60, 60, 25, 25])
    unit = np.empty_like(air)
    unit[0] = air[0]
    for i in range(1, air.size):
        unit[i] = unit[i - 1] + (air[i] - unit[i - 1]) * 10 / 480
    directions = [branch.direction for branch in find_branches(time, unit)]
    assert directions == ["cooling", "constant", "heating", "constant", "cooling", "constant"]


# Run folders ------------------------------------------------------------------------------------------------------


def table_of_loop(tmp_path):
    time, rate, degc = loop()
    body = "\n".join(f"{t},{r / 3600!r},{c + 273.15!r}" for t, r, c in zip(*(x.tolist() for x in (time, rate, degc)),
                                                                         strict=True))  # fmt: skip
    return write(tmp_path, f"time_s,gyro_dps,temp_K\n{body}\n")


def test_an_import_is_a_run_folder_that_the_analysis_reads(tmp_path):
    plan = plan_import(table_of_loop(tmp_path), serial="G 7")
    run = write_import(plan, tmp_path / "reports")
    found = dataset.load(run.path)
    time, rate, degc = loop()
    np.testing.assert_allclose(found.channel("rate"), np.interp(found.time, time, rate), rtol=2e-3)
    np.testing.assert_allclose(found.channel("temperature"), np.interp(found.time, time, degc), atol=0.2)
    assert [segment.direction for segment in found.segments] == ["cooling", "constant", "heating", "cooling"]
    assert set(found.segment) == {0, 1, 2, 3}


def test_the_manifest_names_the_source_and_every_file(tmp_path):
    path = table_of_loop(tmp_path)
    run = write_import(plan_import(path, serial="G 7"), tmp_path / "reports")
    manifest = open_run(run.path).manifest()
    assert (manifest.state, manifest.unit, manifest.rows) == ("done", "G 7", 1200)
    assert manifest.files == run.hashes()
    assert set(manifest.files) == {"data.parquet", "means.parquet", "columns.yaml", "events.jsonl"}
    assert manifest.source["columns"]["rate"] == {"column": "gyro_dps", "unit": "dps", "how": "header"}
    assert len(manifest.source["sha256"]) == 64


def test_the_column_map_in_the_run_folder_repeats_the_import(tmp_path):
    path = table_of_loop(tmp_path)
    first = write_import(plan_import(path), tmp_path / "a")
    second = write_import(plan_import(path, load_columns(first.path / "columns.yaml")), tmp_path / "b")
    assert pq.read_table(first.data).equals(pq.read_table(second.data))


def test_the_same_import_again_is_the_run_that_is_there(tmp_path):
    path = table_of_loop(tmp_path)
    first = write_import(plan_import(path, serial="G 7"), tmp_path / "reports")
    assert write_import(plan_import(path, serial="G 7"), tmp_path / "reports") == first
    assert write_import(plan_import(path, serial="G 8"), tmp_path / "reports") != first


def test_an_import_that_is_interrupted_leaves_nothing_and_what_a_kill_left_goes(tmp_path, monkeypatch):
    killed = subprocess.Popen([sys.executable, "-c", ""])
    killed.wait()
    left = tmp_path / "reports" / f".staged-{killed.pid}-x" / "G 7"
    left.mkdir(parents=True)
    with monkeypatch.context() as patched:
        patched.setattr("bench.acquisition.importer.plan.write_means", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_import(plan_import(table_of_loop(tmp_path)), tmp_path / "reports")
    assert list((tmp_path / "reports").iterdir()) == []


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    blocked = write(tmp_path, "x", "reports")
    with pytest.raises(InputError, match="choose another place"):
        write_import(plan_import(table_of_loop(tmp_path)), blocked)


# Other formats ----------------------------------------------------------------------------------------------------


def test_parquet_keeps_gaps_types_and_units_of_its_fields(tmp_path):
    fields = [pa.field("time", pa.timestamp("ms")), pa.field("gyro", pa.float32(), metadata={"unit": "mdps"}),
              pa.field("temperature", pa.int16()), pa.field("compressor", pa.bool_()),
              pa.field("note", pa.string())]  # fmt: skip
    arrays = [[0, 500, 1000], [1.0, None, 2.0], [20, 21, 22], [True, False, True], ["a", "b", "c"]]
    table = pa.Table.from_arrays(
        [pa.array(a, f.type) for a, f in zip(arrays, fields, strict=True)], schema=pa.schema(fields)
    )
    pq.write_table(table, tmp_path / "x.parquet")
    plan = plan_import(tmp_path / "x.parquet")
    assert plan.time.tolist() == [0, 0.5, 1]
    np.testing.assert_allclose(plan.channels["rate"], [3.6, np.nan, 7.2])
    assert plan.channels["compressor"].tolist() == [1, 0, 1]
    assert "not used             note" in plan.preview()


def test_the_data_of_a_run_folder_can_be_imported_again(tmp_path):
    first = write_import(plan_import(table_of_loop(tmp_path)), tmp_path / "a")
    again = plan_import(first.data)
    np.testing.assert_array_equal(again.channels["rate"], plan_import(table_of_loop(tmp_path)).channels["rate"])


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
    plan = plan_import(path, dbc=DBC)
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
        plan_import(path, dbc=write(tmp_path, "nonsense", "bad.dbc"))
    return str(caught.value)


@pytest.mark.filterwarnings("ignore")
def test_mf4_is_read_with_its_units(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    file = asammdf.MDF()
    fast, slow = np.arange(0, 10, 0.1), np.arange(0, 10, 1.0)
    file.append([asammdf.Signal(np.sin(fast), fast, name="Gyro", unit="deg/s")])
    file.append([asammdf.Signal(20 + slow, slow, name="Temperature", unit="°C")])
    file.save(tmp_path / "x.mf4")
    file.close()
    plan = plan_import(tmp_path / "x.mf4")
    np.testing.assert_allclose(plan.channels["rate"], 3600 * np.sin(fast), rtol=1e-12)
    assert np.count_nonzero(np.isfinite(plan.channels["temperature"])) == 10


def test_a_capital_t_in_degrees_is_a_temperature_and_no_time(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t [s],T (degC),rate [deg/h]\n" + "".join(f"{i},{25 + i / 10},1.5\n" for i in range(50)))
    plan = plan_import(file)
    assert plan.time_source.column == "t [s]"
    assert plan.to_json()["columns"]["temperature"]["column"] == "T (degC)"


def test_a_header_that_no_person_wrote_is_refused_before_it_is_taken_apart(tmp_path):
    for header, said in (("a," * 60_000, "bytes"), ("c,b" + ",a" * 2000, "columns"), ("time,ra\0te", "byte 0")):
        (tmp_path / "odd.csv").write_text(f"{header}\n1,2\n")
        with pytest.raises(InputError, match=said):
            plan_import(tmp_path / "odd.csv")


def ramps(step_s=1.0, first=0.0, rows=4000, low=-40.0, high=85.0, rate=None):
    """Rows of a ramp up and down, a row every so many seconds as the file says."""
    rng = np.random.default_rng(3)
    degc = low + (high - low) * (1 - np.abs(np.linspace(-1, 1, rows)))
    rates = rng.normal(5, 1, rows) if rate is None else np.full(rows, rate)
    lines = (f"{first + i * step_s!r},{rates[i]:.4f},{degc[i]:.4f}" for i in range(rows))
    return "time,rate,temperature\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (ramps(1e-12), "one row every 1e-12 s"),
        (ramps(1e7), "years"),
        (ramps(1e7, rows=5), "one row every 1e+07 s"),
        ("time,rate,temperature\n0,1,20\n1,2,21\n1e300,1,22\n", "years"),
        ("time,rate,temperature\n-1e308,1,20\n1,2,21\n1e308,1,22\n", "time"),
        ("time,rate,temperature\n0,1,20\n1,2,-400\n2,1,22\n", "FILE:3: 'temperature' (temperature) is -400 degC"),
        ("time,rate,temperature\n0,1,20\n1,2,1e5\n2,1,22\n", "FILE:3: 'temperature' (temperature) is 100000 degC"),
        ("time,rate,temperature\n0,1,20\n1,1e200,20\n2,1,22\n", "FILE:3: 'rate' (rate) is 1e+200 deg/h"),
        ("time,rate,temperature,frequency\n0,1,20,-5\n1,2,20,8000\n", "FILE:2: 'frequency' (frequency) is -5 Hz"),
        ("time,rate,temperature\n0,1,20\n1,2,1e-400\n2,1,-1e308\n", "temperature"),
    ],
)
def test_what_nothing_can_have_measured_is_refused(tmp_path, body, words):
    path = write(tmp_path, body)
    with pytest.raises(InputError) as error:
        plan_import(path)
    assert words.replace("FILE", str(path)) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (ramps(10.0, rows=200_000, low=20, high=40), "is the time in ms?"),
        (ramps(1000.0, rows=4000), "is the time in ms?"),
        (ramps(2.0, rows=300_000), "is the time in ms?"),
        (ramps(7200.0, rows=30), "one row every 7.2e+03 s"),
        (ramps(2e-6), "one row every 2e-06 s"),
        (ramps(0.001), "no chamber does"),
        (ramps(rate=5.25), "rate is 5.25 deg/h in every row"),
    ],
)
def test_what_is_unlikely_is_warned_of(tmp_path, body, words):
    (found,) = [warning for warning in plan_import(write(tmp_path, body)).warnings if words in warning]
    assert "\n" not in found


def test_an_ordinary_record_is_not_doubted(tmp_path):
    for step_s, rows in ((1.0, 8000), (0.5, 15_000), (10.0, 1500), (30.0, 800)):
        assert plan_import(write(tmp_path, ramps(step_s, rows=rows))).warnings == ()


def test_all_axes_and_thermometers_of_a_table_become_one_run(tmp_path):
    """As a log of an inertial unit is: three rates and three forces that only their axis tells apart, two dies."""
    degc = np.linspace(-20.0, 60.0, 400)
    columns = {"time [s]": 10.0 * np.arange(400.0), "temp_1 [degC]": degc, "temperature_2": degc + 1.0}
    columns |= {f"g{axis} [dps]": 0.001 * (n + 1) + 1e-5 * degc for n, axis in enumerate("xyz")}
    columns |= {f"acc_{axis} (g)": np.full(400, 0.5 * n) + 1e-6 * degc for n, axis in enumerate("xyz")}
    path = tmp_path / "imu.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    run = write_import(
        plan_import(path, ColumnMap(temperature_1=ChannelSource(column="temp_1 [degC]")), "IMU-1"), tmp_path / "out"
    )
    whole = load(run.path, 60.0)
    assert whole.outputs == ("rate_x", "rate_y", "rate_z", "acceleration_x", "acceleration_y", "acceleration_z")
    assert np.array_equal(whole.channel("temperature"), whole.channel("temperature_1"))
    data = read_samples(run.data)
    assert data["rate_y"] == pytest.approx(3600.0 * columns["gy [dps]"])
    assert data["acceleration_z"] == pytest.approx(9.80665 * columns["acc_z (g)"])
    assert data["temperature_2"] == pytest.approx(degc + 1.0)
    assert [each.manifest().output for each in apart(run)] == ["rate_x", "rate_y", "rate_z"]


def test_one_axis_of_three_is_imported_by_name(tmp_path):
    path = write(tmp_path, "time,gx_dph,gy_dph,gz_dph,temp_C\n0,1,2,3,20\n1,1,2,3,21\n")
    plan = plan_import(path, ColumnMap(rate=ChannelSource(column="gy_dph")))
    assert [mapped.channel for mapped in plan.mapped] == ["rate", "temperature"]
    assert plan.channels["rate"].tolist() == [2.0, 2.0]
