"""Log files as laboratories write them: the numbers are those that other programs read, or one line says what to do.

The list is the table of docs/howto/runs.md.
"""

from __future__ import annotations

import gzip
import json
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import asammdf
import can
import cantools
import h5py
import nptdms
import numpy as np
import pandas as pd
import pytest
import pyulog
import scipy.io
from click.testing import CliRunner

from bench.acquisition.importer.columns import ColumnMap
from bench.analysis import analyse, load_model
from bench.analysis.effects.model import model_from
from bench.analysis.judging.judge import judged_by
from bench.analysis.judging.limits import load_limits
from bench.base import InputError, load_config, parse_yaml
from bench.cli import main
from bench.record import CalibrationRecord
from tests.support.tables import imported

ROOT = Path(__file__).parents[2]
DBC = ROOT / "drivers" / "gyros" / "vibratory.dbc"
PAGE = ROOT / "docs" / "howto" / "runs.md"

Numbers = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Time since the first row [s], rate [deg/h], temperature [degC]; missing values are NaN."""

ROWS, STEP_S = 600, 12.0
TIME = STEP_S * np.arange(ROWS)
DEGC = np.round(np.interp(TIME / TIME[-1], [0, 0.25, 0.75, 1], [25, -30, 70, 25]), 3)
_X = (DEGC - 20) / 50
DPS = np.round((30 + 40 * _X + 15 * _X**2 + np.random.default_rng(1).normal(0, 1, ROWS)) / 3600, 9)
"""A loop 25 → -30 → 70 → 25 degC of two hours; rate in deg/s."""


@dataclass(frozen=True)
class Log:
    """One file: who writes such a file and how, and what `bench import` makes of it."""

    name: str
    how: str
    write: Callable[[Path], object]
    peer: Callable[[Path], Numbers] | None = None
    """Reads it without the bench; None: it is refused."""
    advice: str = ""
    """Of a file that is refused: what the line says."""
    peer_name: str = "pandas"
    columns: str = ""
    """Column map, where the file itself does not say all."""


def table(time: object = TIME, rate: object = DPS, degc: object = DEGC, **more: object) -> pd.DataFrame:
    return pd.DataFrame({"time [s]": time, "rate [deg/s]": rate, "temp [degC]": degc, **more})


def text(**how: object) -> str:
    return table().to_csv(index=False, **how)


def numbers(frame: pd.DataFrame, per_dph: float = 3600.0, offset: float = 0.0) -> Numbers:
    """Of the first three columns; times may be dates."""
    time, rate, degc = (frame.iloc[:, n] for n in range(3))
    if pd.api.types.is_datetime64_any_dtype(time):
        time = (time - time.min()).dt.total_seconds()
    seconds = time.to_numpy(float)
    return seconds - seconds.min(), per_dph * rate.to_numpy(float), degc.to_numpy(float) + offset


def by_pandas(**how: object) -> Callable[[Path], Numbers]:
    return lambda path: numbers(pd.read_csv(path, **how))


def dates(stamps: Callable[[pd.Series], pd.Series], **how: object) -> Callable[[Path], Numbers]:
    return lambda path: numbers(pd.read_csv(path, **how).assign(**{"time [s]": lambda f: stamps(f["time [s]"])}))


BERLIN = pd.date_range("2026-10-25 01:30", periods=ROWS, freq="12s", tz="Europe/Berlin")
NAIVE = pd.date_range("2026-11-22 23:30", periods=ROWS, freq="12s")


def write_text(body: str, encoding: str = "utf-8") -> Callable[[Path], object]:
    return lambda path: path.write_bytes(body.encode(encoding))


def with_gaps() -> str:
    lines = text().splitlines()
    for row, mark in ((9, "---"), (19, "#N/A"), (29, "")):
        lines[row] = ",".join([*lines[row].split(",")[:2], mark])
    return "\n".join([f"{line},{'state' if not at else 'soak; door shut'}" for at, line in enumerate(lines)]) + "\n"


def write_tdms(path: Path) -> None:
    timing = {"wf_start_offset": 0.0, "wf_increment": STEP_S}
    pairs = (("rate", DPS, "deg/s"), ("temperature", DEGC, "degC"))
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([
            nptdms.ChannelObject("log", name, values, {**timing, "unit_string": unit}) for name, values, unit in pairs
        ])  # fmt: skip


def read_tdms(path: Path) -> Numbers:
    group = nptdms.TdmsFile.read(path)["log"]
    return group["rate"].time_track(), 3600.0 * group["rate"][:], group["temperature"][:]


def write_mf4(path: Path) -> None:
    """Two groups: the temperature has every fifth time of the rate."""
    with asammdf.MDF(version="4.10") as file:
        file.append(asammdf.Signal(DPS, TIME, name="rate", unit="deg/s"))
        file.append(asammdf.Signal(DEGC[::5], TIME[::5], name="temperature", unit="degC"))
        file.save(path)


def read_mf4(path: Path) -> Numbers:
    with asammdf.MDF(path) as file:
        rate, degc = file.get("rate"), file.get("temperature")
    slow = pd.Series(degc.samples, degc.timestamps).reindex(rate.timestamps)
    return rate.timestamps, 3600.0 * rate.samples, slow.to_numpy()


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, values, unit in (("time", TIME, "s"), ("rate", DPS, "deg/s"), ("temperature", DEGC, "degC")):
            file[f"log/{name}"] = values
            file[f"log/{name}"].attrs["units"] = unit


def read_hdf5(path: Path) -> Numbers:
    with h5py.File(path) as file:
        return file["log/time"][:], 3600.0 * file["log/rate"][:], file["log/temperature"][:]


def write_ulog(path: Path) -> None:
    """By the definition of ULog: a topic with the rate, and one with the temperature at a fifth of its times."""
    size, file = struct.Struct("<HB"), b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)

    def message(kind: str, body: bytes) -> bytes:
        return size.pack(len(body), ord(kind)) + body

    topics = {"gyro": ("rate", np.radians(DPS), 1), "baro": ("temperature", DEGC, 5)}
    file += message("B", bytes(40))
    file += b"".join(
        message("F", f"{topic}:uint64_t timestamp;double {name};".encode()) for topic, (name, _, _) in topics.items()
    )
    file += b"".join(message("A", struct.pack("<BH", 0, at) + topic.encode()) for at, topic in enumerate(topics))
    for row in range(ROWS):
        for at, (_, values, every) in enumerate(topics.values()):
            if row % every == 0:
                file += message("D", struct.pack("<HQd", at, round(1e6 * TIME[row]), values[row]))
    path.write_bytes(file)


def read_ulog(path: Path) -> Numbers:
    data = {topic.name: topic.data for topic in pyulog.ULog(str(path)).data_list}
    gyro, baro = data["gyro"], data["baro"]
    slow = pd.Series(baro["temperature"], baro["timestamp"]).reindex(gyro["timestamp"])
    return 1e-6 * gyro["timestamp"], 3600.0 * np.degrees(gyro["rate"]), slow.to_numpy()


def write_blf(path: Path) -> None:
    """One frame of the rate and one of the temperature a row, at the same time."""
    database = cantools.database.load_file(DBC)
    rate, slow = (database.get_message_by_name(name) for name in ("GYRO_RATE", "GYRO_RES"))
    with can.BLFWriter(path) as log:
        for row in range(ROWS):
            for message, values in ((rate, {"Rate": DPS[row]}), (slow, {"Temperature": DEGC[row]})):
                given = {signal.name: values.get(signal.name, 0) for signal in message.signals}
                data = message.encode(given, strict=False)
                log(can.Message(1e9 + TIME[row], message.frame_id, is_extended_id=False, data=data))


def read_blf(path: Path) -> Numbers:
    database, found = cantools.database.load_file(DBC), []
    with can.LogReader(path) as log:
        for frame in log:
            values = database.decode_message(frame.arbitration_id, frame.data, decode_choices=False)
            found.append((frame.timestamp, values.get("Rate"), values.get("Temperature")))
    frame = pd.DataFrame(found, columns=["t", "rate", "degc"]).groupby("t").first().reset_index()
    return numbers(frame)


def two_sheets(path: Path) -> None:
    with pd.ExcelWriter(path) as file:
        pd.DataFrame({"unit": ["G-1042"], "operator": ["A. Example"]}).to_excel(file, sheet_name="about", index=False)
        table().to_excel(file, sheet_name="data", index=False)


ABOUT = "Instrument,DAQ970A\nSerial,MY58000001\nStart,2026-11-22 10:00:00\n\n"
TRACKER = "// General information:\n//  Update rate: 10.0Hz\n//  Filter profile: general\n"
LVM = ("LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\t\n\nChannels\t2\t\n"
       "***End_of_Header***\t\t\nX_Value\trate\ttemperature\tComment\n0\t1.0\t20\n6\t1.0\t20\n")  # fmt: skip
LONG = "time [s],rate [deg/h],temp [degC]\n" + "".join(f'{n},"1,23{n}.5",2{n}.0\n' for n in range(9))

LOGS = (
    Log("plain.csv", "commas, UTF-8, units in the names", write_text(text()), by_pandas()),
    Log("german.csv", "semicolons, decimal commas, Windows-1252, `°/s`, `°C`, German names",
        write_text(table().set_axis(["Zeit [s]", "Drehrate [°/s]", "Temperatur [°C]"], axis=1)
                   .to_csv(index=False, sep=";", decimal=","), "cp1252"),
        by_pandas(sep=";", decimal=",", encoding="cp1252")),
    Log("unicode_text.txt", "a spreadsheet's Unicode text: tabs, UTF-16",
        write_text(text(sep="\t"), "utf-16"), by_pandas(sep="\t", encoding="utf-16")),
    Log("sep.csv", "a spreadsheet's CSV whose first line is `sep=;`",
        write_text("sep=;\n" + text(sep=";")), by_pandas(sep=";", skiprows=1)),
    Log("zoned.csv", "ISO 8601 with zone, over the end of summer time",
        write_text(table([stamp.isoformat() for stamp in BERLIN]).to_csv(index=False)),
        dates(lambda column: pd.to_datetime(column, utc=True))),
    Log("local.csv", "times as 22.11.2026 23:30:00,0 over midnight, decimal commas",
        write_text(table(NAIVE.strftime("%d.%m.%Y %H:%M:%S,0")).to_csv(index=False, sep=";", decimal=",")),
        dates(lambda column: pd.to_datetime(column, format="%d.%m.%Y %H:%M:%S,%f"), sep=";", decimal=",")),
    Log("american.csv", "times as 11/22/2026 11:30:00 PM over midnight",
        write_text(table(NAIVE.strftime("%m/%d/%Y %I:%M:%S %p")).to_csv(index=False)),
        dates(lambda column: pd.to_datetime(column, format="%m/%d/%Y %I:%M:%S %p"))),
    Log("states.csv", "a column of text, and `---`, `#N/A` or nothing where a value is missing",
        write_text(with_gaps()), by_pandas(na_values=["---"])),
    Log("packed.csv.gz", "gzip", lambda path: path.write_bytes(gzip.compress(text().encode())), by_pandas()),
    Log("si.csv", "rad/s and kelvin",
        write_text(table(TIME, np.radians(DPS), DEGC + 273.15).set_axis(["time_s", "rate_rad/s", "temp_K"], axis=1)
                   .to_csv(index=False)),
        lambda path: numbers(pd.read_csv(path), 3600.0 * 180.0 / np.pi, -273.15)),
    Log("daq970a.csv", "a data logger: lines about the instrument before the header",
        write_text(ABOUT + text()), by_pandas(skiprows=4)),
    Log("units_row.csv", "a row of units below the names",
        write_text("time,rate,temperature\ns,deg/s,°C\n" + text(header=False)), by_pandas(skiprows=[1])),
    Log("tracker.txt", "a motion tracker's export: `//` before remarks, tabs",
        write_text(TRACKER + text(sep="\t")), by_pandas(sep="\t", skiprows=3)),
    Log("newest_first.csv", "milliseconds since 1970, newest row first, a comma at the end of each line",
        write_text("timestamp_ms,rate [deg/s],temp [degC],\n" + "".join(
            f"{1_790_000_000_000 + 1000 * t:.0f},{rate!r},{degc!r},\n"
            for t, rate, degc in zip(TIME[::-1].tolist(), DPS[::-1].tolist(), DEGC[::-1].tolist(), strict=True))),
        lambda path: numbers(pd.read_csv(path).assign(timestamp_ms=lambda f: 1e-3 * f["timestamp_ms"])
                             .sort_values("timestamp_ms"))),
    Log("bench.xlsx", "a spreadsheet with dates", lambda path: table(NAIVE).to_excel(path, index=False),
        lambda path: numbers(pd.read_excel(path)), peer_name="pandas, openpyxl"),
    Log("archive.parquet", "Parquet with zoned times",
        lambda path: table(BERLIN).to_parquet(path), lambda path: numbers(pd.read_parquet(path))),
    Log("daq.tdms", "LabVIEW TDMS, waveforms", write_tdms, read_tdms, peer_name="nptdms"),
    Log("two_rates.mf4", "MF4, the temperature at a fifth of the rate", write_mf4, read_mf4, peer_name="asammdf"),
    Log("logger.h5", "HDF5 with the attribute `units`", write_hdf5, read_hdf5, peer_name="h5py"),
    Log("flight.ulg", "a flight log (ULog) of two topics, with a column map for the unit of the rate",
        write_ulog, read_ulog, peer_name="pyulog", columns="rate: {column: gyro.rate, unit: rad/s}\n"),
    Log("trace.blf", "a CAN trace with its DBC", write_blf, read_blf, peer_name="python-can, cantools"),
    Log("grad.csv", "`grad/s`", write_text(text().replace("deg/s", "grad/s")),
        advice="'grad/s' has two meanings: degree, or gon"),
    Log("day_or_month.csv", "times as 03/04/2026 10:00",
        write_text(table(["03/04/2026 10:00", "03/05/2026 10:01"] * (ROWS // 2)).to_csv(index=False)),
        advice="the day or the month first? export times as 2026-01-31 14:00:00"),
    Log("overload.csv", "`OVLD` in a field", write_text(text().replace(f",{DEGC[5]}\n", ",OVLD\n", 1)),
        advice="'temp [degC]' is 'OVLD', not a number; leave a field empty where there is no value"),
    Log("thousands.csv", "`1,234.5`", write_text(LONG), advice="separators of thousands? export without them"),
    Log("statistics.csv", "lines of minimum and maximum below the rows", write_text(text() + "Max,0.02,70\n"),
        advice="'time [s]' is 'Max', not a number; leave a field empty where there is no value, and begin a line "
               "that is no row with #"),
    Log("twice.csv", "two exports in one file", write_text(text() + text()),
        advice="the header stands again; delete that line"),
    Log("labview.lvm", "LabVIEW text with two heads", write_text(LVM),
        advice="delete lines that do not belong to the table, or begin them with #"),
    Log("two_sheets.xlsx", "the table is on the second sheet", two_sheets,
        advice="it is the first sheet that is read, 'about'"),
    Log("workspace.mat", "a MATLAB workspace", lambda path: scipy.io.savemat(path, {"rate": DPS}),
        advice="export it as one of text tables (also .gz or .zip), .parquet"),
)  # fmt: skip

READ = [log for log in LOGS if log.peer is not None]
REFUSED = [log for log in LOGS if log.peer is None]


@pytest.mark.parametrize("log", READ, ids=lambda log: log.name)
def test_a_log_is_imported_with_the_numbers_that_another_program_reads(tmp_path: Path, log: Log) -> None:
    path = tmp_path / log.name
    log.write(path)
    assert log.peer is not None
    time, rate, degc = log.peer(path)
    assert time.size == ROWS
    columns = load_config(parse_yaml(log.columns, "map"), ColumnMap) if log.columns else None
    plan = imported(path, columns, dbc=DBC if path.suffix == ".blf" else None)
    np.testing.assert_allclose(plan.time, time, rtol=0, atol=1e-6)
    np.testing.assert_allclose(plan.channels["rate"], rate, rtol=1e-13, atol=1e-9)
    np.testing.assert_allclose(plan.channels["temperature"], degc, rtol=0, atol=1e-9)


@pytest.mark.parametrize("log", REFUSED, ids=lambda log: log.name)
def test_a_log_that_is_refused_is_one_line_that_says_what_to_do(tmp_path: Path, log: Log) -> None:
    path = tmp_path / log.name
    log.write(path)
    with pytest.raises(InputError) as caught:
        imported(path)
    said = str(caught.value)
    assert "\n" not in said
    assert str(path) in said
    assert log.advice in said


PAPERS = {
    "laboratory": "laboratory: {name: Example Laboratory}\nauthorised_by: {name: A. Example, function: head}\n",
    "equipment": "equipment:\n"
    "- {name: Pt100, serial: T-1, certificate: C-1, calibrated: 2000-01-01, due: 2999-01-01}\n",
    "limits": "name: log\nlimits:\n- {quantity: residual_rms_dph, unit: deg/h, upper: 2, reason: test}\n"
    "- {name: hottest, expression: max(temperature), unit: degC, lower: 69, upper: 71, reason: test}\n",
}


@pytest.mark.parametrize("log", READ, ids=lambda log: log.name)
def test_what_was_imported_is_reported_exported_and_certified(tmp_path: Path, log: Log) -> None:
    """The exported curve is numpy's through the other program's numbers; the laboratory's limits judge it."""
    path = tmp_path / log.name
    log.write(path)
    more = ["--dbc", DBC] if path.suffix == ".blf" else []
    if log.columns:
        (tmp_path / "map.yaml").write_text(log.columns)
        more = ["--columns", tmp_path / "map.yaml"]
    bench("import", path, "--unit", "LOG-0007", "--out", tmp_path / "reports", *more)
    (run,) = (tmp_path / "reports" / "LOG-0007").iterdir()
    analysis = analyse(run, [load_model("polynomial")], diagnose=False)
    assert not analysis.done.gaps_s
    assert CalibrationRecord.read(run).refusals == ()
    bench("export", run, "--format", "json", "--out", tmp_path / "export")
    exported = json.loads((tmp_path / "export" / "calibration.json").read_text())
    curve = np.polynomial.Polynomial([one["value"] for one in exported["physical"]])
    assert log.peer is not None
    _, rate, degc = log.peer(path)
    known = np.isfinite(degc)
    at = np.linspace(-30, 70, 11)
    np.testing.assert_allclose(curve(at), np.polynomial.Polynomial.fit(degc[known], rate[known], 3)(at), atol=0.3)
    given = []
    for name, text in PAPERS.items():
        (tmp_path / f"{name}.yaml").write_text(text)
        given += [f"--{name}", tmp_path / f"{name}.yaml"]
    bench("certificate", run, *given)
    said = json.loads((run / "certificate.json").read_text())
    assert (said["verdict"], said["item"]["serial"]) == ("PASS", "LOG-0007")
    assert [one["name"] for one in said["conformity"]["results"]] == ["residual_rms_dph", "hottest"]
    assert (run / "certificate.pdf").read_bytes().startswith(b"%PDF")


def test_what_an_instrument_measured_is_in_models_and_limits(tmp_path: Path) -> None:
    humidity = 40 + 10 * np.sin(TIME / 500)
    table(rate=DPS + 0.5 * (humidity - 40) / 3600, **{"humidity [%]": humidity}).to_csv(
        tmp_path / "log.csv", index=False
    )
    bench("import", tmp_path / "log.csv", "--unit", "LOG-0008", "--out", tmp_path / "reports")
    (run,) = (tmp_path / "reports" / "LOG-0008").iterdir()
    effects = [{"polynomial": {"order": 3}}, {"expression": {"formula": "a*humidity"}}]
    analysis = analyse(run, [model_from({"name": "moist", "effects": effects})], diagnose=False)
    assert analysis.best is not None
    (found,) = [one.value for one in analysis.best.fit.coefficients if one.key.startswith("expression")]
    assert found == pytest.approx(0.5, abs=0.03)
    wet = {"name": "wettest", "expression": "max(humidity)", "unit": "%", "upper": 45, "reason": "test"}
    limits = load_limits(parse_yaml(json.dumps({"name": "moist", "limits": [wet]}), "limits.yaml"))
    judged = judged_by(analysis, limits).judgement
    assert judged is not None
    (result,) = judged.results
    assert (result.verdict, result.quantity.value) == ("FAIL", pytest.approx(50, abs=0.1))


def bench(*args: object) -> None:
    result = CliRunner().invoke(main, [str(arg) for arg in args])
    assert result.exit_code == 0, result.output


def test_the_page_lists_these_files() -> None:
    rows = [line for line in PAGE.read_text().splitlines() if re.match(r"\| `[a-z0-9_]+\.[a-z0-9.]+` \|", line)]
    assert rows == list(lines())


def lines() -> Iterator[str]:
    """Rows of the table of the page."""
    for log in LOGS:
        done = (
            f"imported, certified; the numbers are those of {log.peer_name}" if log.peer else f"refused: {log.advice}"
        )
        yield f"| `{log.name}` | {log.how} | {done} |"


if __name__ == "__main__":
    print(*lines(), sep="\n")
