"""Foreign text tables: read exactly, or refused with file and line."""

import gzip
import io

import numpy as np
import pandas as pd
import pytest

from bench.acquisition.importer.columns import ChannelSource, ColumnMap
from bench.acquisition.importer.plan import load_columns, plan_table, write_import
from bench.acquisition.importer.tables import read_table
from bench.base import load_config, parse_yaml
from bench.base.errors import InputError
from tests.support.tables import TABLE, imported, refusal, write


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_a_table_is_read_with_any_usual_delimiter_comments_and_a_byte_order_mark(tmp_path, delimiter):
    rows = [["time_s", "rate_dph", "temp_C"], ["0", "1.5", "20"], ["1", "-2e0", "21"], ["2", "nan", "22"]]
    body = "\n".join(delimiter.join(row) for row in rows)
    plan = imported(write(tmp_path, f"\ufeff# made by us\n\n{body}\n"))
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


def test_a_quoted_header_may_hold_the_delimiter(tmp_path):
    plan = imported(write(tmp_path, '"time (s)","rate [deg/s]","T, inner"\n0,1,20\n1,1,21\n'),
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
        ("signs.csv", "Zeit [ms];Ω_z °/h;T/°C;U_batt mV\n0;1;20;5000\n1000;-1;21;5010\n2000;1;22;5020\n"),
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
    plan = imported(write(tmp_path, content, name))
    assert plan.time.tolist() == [0, 1, 2]
    factor = 3600 if name == "capitals.csv" else 1
    assert (plan.channels["rate"] / factor).tolist() == [1, -1, 1]
    np.testing.assert_allclose(plan.channels["temperature"], [20, 21, 22], atol=1e-9)
    assert ("supply" in plan.channels) == (name == "signs.csv")


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
        ("half_zoned.csv", NUMBERED.replace("\n0", "\n2026-10-25T01:30:00Z").replace("\n1", "\n2026-10-25T01:30:01"),
         "FILE:3: 'time' is '2026-10-25T01:30:01', no time as in the rows before"),
        ("nbsp.csv", NUMBERED.replace(",", ";").replace(";20", ";1\xa0020,5"),
         "FILE:2: 'temp [degC]' is '1 020,5', not a number: separators of thousands?"),
        ("neither.csv", NUMBERED.replace("rate [deg/h]", "a").replace("temp [degC]", "b"),
         "FILE: no column is rate or temperature; the table has 'time', 'a', 'b'"),
        ("no_time.csv", NUMBERED.replace("time", "Datum"),
         "FILE: no column is time; the table has 'Datum', 'rate [deg/h]', "),
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
    plan = imported(write(tmp_path, f"date,clock,rate [deg/h],temp [degC]\n{rows}"))
    assert plan.time.tolist() == [0, 10, 201_610, 201_620]


def test_a_log_with_dates_keeps_its_first_moment_which_is_no_warning(tmp_path):
    rows = "".join(f"2026-11-20 23:59:{50 + i},1,20\n" for i in range(4))
    plan = imported(write(tmp_path, f"time,rate [deg/h],temp [degC]\n{rows}"))
    begin = "'time' begins at 2026-11-20 23:59:50"
    assert begin in plan.warnings
    assert begin not in plan.doubts
    assert f"  note: {begin}\n" in plan.preview()


def test_comments_and_blank_lines_between_rows_keep_the_line_numbers(tmp_path):
    text = "# one\r\ntime,rate,temperature\r\n0,1,20\r\n\r\n# stop\r\n2,1,20\r\n1.9,1,20\r\n"
    assert refusal(write(tmp_path, text)).startswith("FILE:7: time runs backwards")
    assert imported(write(tmp_path, text.replace("\n1.9,1", "\n3,1"))).time.tolist() == [0, 2, 3]


def test_numbers_are_read_to_the_last_digit(tmp_path):
    values = np.random.default_rng(1).normal(14000, 1, 50)
    body = "\n".join(f"{i},{value!r},20" for i, value in enumerate(values.tolist()))
    plan = imported(write(tmp_path, f"time,rate,temperature\n{body}\n"))
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
        ("time,volts,temperature\n0,1,20\n1,1,20\n",
         "FILE: no column is rate; the table has 'time', 'volts', 'temperature'"),
        ("time,gx_dph,gy_dph,temp_C\n0,1,1,20\n1,1,1,20\n", "FILE: several columns could be rate: gx_dph, gy_dph"),
        ("time,gz,temp_C\n0,1,20\n1,1,20\n", "FILE: 'gz' does not say its unit"),
        ("sample,gx,gy,gz,temp_C\n0,1,1,1,20\n1,1,1,1,20\n",
         "FILE: 'sample' counts samples, and nothing says how long one takes; say it in a column map, "
         "`time: {column: sample, interval_s: …}`; 'gx', 'gy', 'gz' do not say their units, which may be deg/h, deg/s, "
         "mdps, rad/s; say them in a column map, `rate_x: {column: gx, unit: …}, rate_y: {column: gy, unit: …}, "),
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
        assert "its last number may be cut off" in imported(path).warnings[0]


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
    plan = imported(path)
    np.testing.assert_array_equal(plan.time, TABLE["time"])
    np.testing.assert_array_equal(plan.channels["rate"], TABLE["rate"])
    np.testing.assert_array_equal(plan.channels["temperature"], TABLE["temperature"])


def test_a_header_that_no_person_wrote_is_refused_before_it_is_taken_apart(tmp_path):
    for header, said in (("a," * 60_000, "bytes"), ("c,b" + ",a" * 2000, "columns"), ("time,ra\0te", "byte 0")):
        (tmp_path / "odd.csv").write_text(f"{header}\n1,2\n")
        with pytest.raises(InputError, match=said):
            imported(tmp_path / "odd.csv")
