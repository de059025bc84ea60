"""Names, units and column maps of foreign tables."""

import numpy as np
import pytest

from bench.acquisition.importer.columns import ChannelSource, ColumnMap, split_header
from bench.acquisition.importer.plan import load_columns
from bench.acquisition.importer.units import conversion
from bench.base.errors import InputError
from tests.support.tables import imported, refusal, write


def test_the_units_of_a_header_stand_before_those_below_it(tmp_path):
    plan = imported(write(tmp_path, "time,rate [deg/h],temperature\nmin,deg/s,degC\n0,1,20\n1,1,20\n"))
    assert plan.time.tolist() == [0, 60]
    assert plan.channels["rate"].tolist() == [1, 1]
    assert "line 2 was read as the units of the columns" in plan.warnings


@pytest.mark.parametrize(
    "header",
    [
        "Час, с;Кутова швидкість, °/с;Температура, °C",
        "Время, с;Угловая скорость, град/с;Температура, °С",
        "Час, с;Зміщення, °/с;Температура, °C",
        "时间(s);零偏(°/s);温度(℃)",
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
    plan = imported(write(tmp_path, f"{header}\n{rows}"))
    assert plan.time.tolist() == [0, 1, 2]
    np.testing.assert_allclose(plan.channels["rate"], [0, 3.6, 7.2], atol=1e-9)
    np.testing.assert_allclose(plan.channels["temperature"], [20, 21, 22], atol=1e-9)


def test_what_instruments_measured_is_imported_where_its_unit_is_stated(tmp_path):
    rows = "".join(f"{i},1,2{i},4{i},29{i}.15,150,7\n" for i in range(3))
    head = "time,rate [deg/h],temp [degC],humidity [%],Reference temperature [K],supply current [mA],pressure\n"
    plan = imported(write(tmp_path, head + rows))
    assert {*plan.channels} - {"rate", "temperature"} == {"humidity", "reference_temperature", "supply_current"}
    np.testing.assert_allclose(plan.channels["reference_temperature"], [16.0 + i + 1 for i in range(3)])
    np.testing.assert_allclose(plan.channels["supply_current"], 0.15)
    columns = ColumnMap(pressure=ChannelSource(column="pressure", unit="kPa"))
    assert imported(write(tmp_path, head + rows), columns).channels["pressure"].tolist() == [70, 70, 70]


@pytest.mark.parametrize(
    ("header", "channel", "value"),
    [
        ("pressure_hPa", "pressure", 40.0),
        ("pressure_kPa", "pressure", 400.0),
        ("supply_current_mA", "supply_current", 0.04),
        ("humidity", "humidity", 40.0),
        ("RH_%", "humidity", 40.0),
        ("Relative humidity [%]", "humidity", 40.0),
    ],
)
def test_a_unit_behind_an_underscore_is_read(tmp_path, header, channel, value):
    rows = "".join(f"{i},1,2{i},40\n" for i in range(3))
    plan = imported(write(tmp_path, f"time_s,rate_dph,temp_C,{header}\n{rows}"))
    np.testing.assert_allclose(plan.channels[channel], value)


@pytest.mark.parametrize("unit", ["mps2", "m/s2", "m/s^2", "m s-2"])
def test_accelerations_beside_three_rates_are_taken_with_their_unit(tmp_path, unit):
    header = ",".join([f"g{axis}_dph" for axis in "xyz"] + [f"a{axis} [{unit}]" for axis in "xyz"])
    if unit == "mps2":
        header = header.replace(" [mps2]", "_mps2")
    plan = imported(write(tmp_path, f"time_s,temp_C,{header}\n0,20,1,2,3,0,0,9.8\n1,21,1,2,3,0,0,9.8\n"))
    assert plan.channels["acceleration_z"].tolist() == [9.8, 9.8]


def test_a_column_of_sample_numbers_is_no_time_until_the_step_is_stated(tmp_path):
    path = write(tmp_path, "sample,rate [deg/h],temp [degC]\n0,1,20\n1,1,21\n")
    assert "nothing says how long one takes" in refusal(path, ColumnMap(time={"column": "sample"}))
    assert imported(path, ColumnMap(time={"column": "sample", "rate_hz": 200})).time.tolist() == [0.0, 0.005]
    assert imported(path, ColumnMap(time={"column": "sample", "unit": "ms"})).time.tolist() == [0.0, 0.001]


@pytest.mark.parametrize("words", [("ON", "off"), ("True", "False"), ("yes", "no")])
def test_words_of_a_switch_are_one_and_nought(tmp_path, words):
    on, off = words
    rows = f"0,1,20,{on}\n1,1,21,{off}\n2,1,22,\n3,1,23,{on}\n"
    plan = imported(write(tmp_path, f"time,rate [deg/h],temp [degC],compressor\n{rows}"))
    np.testing.assert_array_equal(plan.channels["compressor"], [1, 0, np.nan, 1])
    assert any("read as 1 and 0" in warning for warning in plan.warnings)


def test_a_channel_with_its_unit_in_the_header_is_that_channel(tmp_path):
    plan = imported(write(tmp_path, "time_s,rate_dph,temperature_1_C,Temperature_2_K\n0,1,20,293.15\n1,1,21,294.15\n"))
    np.testing.assert_allclose(plan.channels["temperature_2"], [20, 21])
    np.testing.assert_allclose(plan.channels["temperature_1"], [20, 21])


@pytest.mark.parametrize("header", ["imu_temp_degC", "Die temp [degC]", "T_temp_sensor", "Sonde [°C]"])
def test_the_only_column_that_may_be_a_thermometer_is_the_units(tmp_path, header):
    rows = "".join(f"{i},1,2{i},30\n" for i in range(3))
    plan = imported(write(tmp_path, f"time_s,rate_dph,{header},chamber_temp\n{rows}"))
    assert plan.channels["temperature"].tolist() == [20, 21, 22]
    both = write(tmp_path, f"time_s,rate_dph,{header},case_temp\n{rows}")
    assert "no column is temperature" in refusal(both)


def test_the_only_column_in_a_unit_of_a_channel_is_that_channel(tmp_path):
    plan = imported(write(tmp_path, "від пуску, хв;Т датчика, °C;вихід, °/с;U, В\n0;20,5;1;5\n0,5;21;2;5\n1;22;1;5\n"))
    assert plan.time.tolist() == [0, 30, 60]
    assert plan.channels["temperature"].tolist() == [20.5, 21, 22]
    assert plan.channels["rate"].tolist() == [3600, 7200, 3600]
    two = write(tmp_path, "time;A, °/с;B, °/год;T, °C\n0;1;1;20\n1;1;1;20\n")
    assert "no column is rate; the table has 'time', 'A, °/с', 'B, °/год', 'T, °C'" in refusal(two)


def test_a_quantity_that_no_channel_is_is_taken_where_the_map_names_it(tmp_path):
    path = write(tmp_path, "time,rate [deg/h],temp [degC],vibration_g,phase_A\n0,1,20,0.1,2\n1,1,21,0.2,3\n")
    plan = imported(path)
    assert "not used             vibration_g, phase_A" in plan.preview()
    assert "`other_1: {column: vibration_g}`" in plan.preview()
    columns = ColumnMap.model_validate({"other_1": {"column": "vibration_g"}})
    plan = imported(path, columns)
    assert plan.channels["other_1"].tolist() == [0.1, 0.2]
    assert "`other_2: {column: phase_A}`" in plan.preview()


def test_a_text_column_is_an_error_only_where_it_is_wanted(tmp_path):
    path = write(tmp_path, "time,rate,temperature,note\n0,1,20,warm\n1,1,20,\n2,oops,20,\n")
    assert refusal(path).startswith("FILE:4: 'rate' is 'oops', not a number")
    plan = imported(write(tmp_path, "time,rate,temperature,note\n0,1,20,warm\n1,1,20,\n2,1,20,\n"))
    assert "not used             note" in plan.preview()


@pytest.mark.parametrize(
    ("channel", "unit", "given", "expected"),
    [
        ("rate", "deg/h", 2.0, 2.0), ("rate", "deg/s", 1.0, 3600.0), ("rate", "dps", 1.0, 3600.0),
        ("rate", "mdps", 1.0, 3.6), ("rate", "rad/s", 1.0, 3600 * 180 / np.pi),
        ("rate", "mrad/s", 1.0, 3.6 * 180 / np.pi),
        ("rate", "arcsec/s", 1.0, 1.0), ("rate", "°/h", 5.0, 5.0), ("rate", "rpm", 1.0, 21600.0),
        ("temperature", "K", 273.15, 0.0), ("temperature", "degF", 212.0, 100.0), ("temperature", "F", -40.0, -40.0),
        ("temperature", "°C", 5.0, 5.0), ("temperature", "C", 5.0, 5.0),
        ("temperature", "Grad C", 5.0, 5.0), ("temperature", "Grad Celsius", 5.0, 5.0),
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
    plan = imported(path, load_columns(map_path))
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


def test_a_capital_t_in_degrees_is_a_temperature_and_no_time(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t [s],T (degC),rate [deg/h]\n" + "".join(f"{i},{25 + i / 10},1.5\n" for i in range(50)))
    plan = imported(file)
    assert plan.time_source.column == "t [s]"
    assert plan.to_json()["columns"]["temperature"]["column"] == "T (degC)"


def test_one_axis_of_three_is_imported_by_name(tmp_path):
    path = write(tmp_path, "time,gx_dph,gy_dph,gz_dph,temp_C\n0,1,2,3,20\n1,1,2,3,21\n")
    plan = imported(path, ColumnMap(rate=ChannelSource(column="gy_dph")))
    assert [mapped.channel for mapped in plan.mapped] == ["rate", "temperature"]
    assert plan.channels["rate"].tolist() == [2.0, 2.0]
