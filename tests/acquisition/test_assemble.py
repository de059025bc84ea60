"""From journals to tables: held against cantools, gaps stay gaps, everything on its tick."""

import json
import shutil

import cantools
import numpy as np
import pyarrow.parquet as pq
import pytest

import bench.acquisition.recording.assemble
import bench.acquisition.recording.tables
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.recording.recorder import READING
from bench.base.errors import InputError
from bench.record.files import sha256
from bench.record.folder import RunFolder
from bench.record.samples import read_samples
from drivers.journal import FRAME, JournalWriter, Kind, read_blocks, stored_blocks
from drivers.wire import load_dbc
from tests.support import acquisition

DBC = cantools.database.load_file(acquisition.STATION.parents[2] / "drivers" / "gyros" / "vibratory.dbc")
ID = {name: message.id for name, message in load_dbc("vibratory").items()}
CHANNELS = {
    "temperature": ("GYRO_RES", "Temperature"),
    "frequency": ("GYRO_RES", "ResonanceFrequency"),
    "drive": ("GYRO_AMP", "DriveAmplitude"),
    "quadrature": ("GYRO_AMP", "QuadratureAmplitude"),
    "supply": ("GYRO_SUPPLY", "SupplyVoltage"),
}


@pytest.fixture
def copy(short_run, tmp_path):
    """A copy of the finished run, to be spoilt."""
    shutil.copytree(short_run.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def table(run):
    return read_samples(run.data)


def frames_of(run):
    return np.concatenate([b.frames() for b in read_blocks(run.journal / "can0.gtbj") if b.kind is Kind.FRAMES])


def readings_of(run):
    return np.concatenate(
        [np.frombuffer(b.payload, READING) for b in read_blocks(run.journal / "bench.gtbj") if b.kind is Kind.READING]
    )


def rewrite(run, frames, block=700):
    """Replace the journal of the bus by one that holds these frames."""
    path = run.journal / "can0.gtbj"
    path.unlink()
    writer = JournalWriter(path)
    for start in range(0, len(frames), block):
        part = frames[start : start + block]
        writer.append(Kind.FRAMES, part.tobytes(), len(part), float(part["t_ns"][-1]) * 1e-9)
    writer.close()


def decoded(frame):
    message = next(message for message in DBC.messages if message.frame_id == frame["id"])
    return DBC.decode_message(message.frame_id, bytes(frame["data"][: frame["len"]]), decode_choices=False)


def test_rates_are_those_that_cantools_decodes(short_run):
    frames = frames_of(short_run)
    rates = frames[frames["id"] == ID["GYRO_RATE"]]
    data = table(short_run)
    chosen = np.linspace(0, len(rates) - 1, 300).astype(int)
    for i in chosen:
        answer = decoded(rates[i])
        assert answer["SampleCounter"] == i % 65536
        assert data["rate"][i] == pytest.approx(answer["Rate"] * 3600.0, abs=1e-9)
        assert data["time"][i] == pytest.approx(i * 0.002, abs=1e-9)


@pytest.mark.parametrize("channel", CHANNELS)
def test_slow_channels_are_those_that_cantools_decodes_on_the_tick_of_their_counter(short_run, channel):
    message, signal = CHANNELS[channel]
    frames = frames_of(short_run)
    column = table(short_run)[channel]
    sent = frames[frames["id"] == ID[message]]
    at = np.flatnonzero(np.isfinite(column))
    assert len(at) == len(sent)
    for i in np.linspace(0, len(sent) - 1, min(200, len(sent))).astype(int):
        answer = decoded(sent[i])
        assert answer["SlowCounter"] == at[i] & 0xFF
        assert column[at[i]] == pytest.approx(answer[signal], rel=1e-12)


def test_chamber_readings_stand_on_the_nearest_tick_and_nowhere_else(short_run):
    readings, data = readings_of(short_run), table(short_run)
    at = np.flatnonzero(np.isfinite(data["chamber_temperature"]))
    assert len(at) == len(readings)
    assert np.all(np.abs(data["time"][at] - readings["t_s"]) <= 0.001 + 1e-9)
    assert np.array_equal(data["chamber_temperature"][at], readings["temperature"])
    assert np.array_equal(data["chamber_setpoint"][at], readings["working_setpoint"])


def test_readings_find_their_tick_under_a_clock_that_runs_differently(copy):
    frames = frames_of(copy).copy()
    frames["t_ns"] = (frames["t_ns"] * (1 + 200e-6)).astype(np.int64) + 12_345_678
    rewrite(copy, frames)
    manifest = assemble(copy)
    assert manifest.unit_clock.drift_ppm == pytest.approx(200, rel=1e-3)
    readings, data = readings_of(copy), table(copy)
    at = np.flatnonzero(np.isfinite(data["chamber_temperature"]))
    assert np.all(np.abs(data["time"][at] - readings["t_s"]) <= 0.001 + 1e-6)


def test_a_counter_that_starts_anywhere_changes_nothing(copy):
    before = table(copy)
    frames = frames_of(copy)
    rewrite(copy, frames[frames["t_ns"] >= 5_000_000_000])  # the counter is at 2500 when the record starts
    assemble(copy)
    after = table(copy)
    late = before["time"] >= 5.0 - 1e-9
    held = np.isfinite(after["rate"])
    assert np.array_equal(after["rate"][held], before["rate"][late & np.isfinite(before["rate"])])
    assert np.count_nonzero(np.isfinite(after["chamber_temperature"])) == len(readings_of(copy))


def test_segments_are_where_the_sequencer_had_them(short_run):
    data, segments = table(short_run), short_run.manifest().segments
    expected = np.full(len(data["time"]), -1)
    for segment in segments:
        inside = (data["time"] >= segment.from_s) & (data["time"] < segment.to_s)
        expected[inside] = segment.index
    assert np.array_equal(data["segment"], expected)
    assert set(np.unique(expected)) == {-1, 0, 1}


def test_gaps_stay_gaps(copy):
    before, frames = table(copy), frames_of(copy)
    t_s = frames["t_ns"] * 1e-9
    rewrite(copy, frames[~((t_s >= 40.0005) & (t_s < 41.2005))])
    manifest = assemble(copy)
    after = table(copy)
    gone = (before["time"] > 40.0005) & (before["time"] < 41.2005)
    missing = np.count_nonzero(gone)
    assert missing == 600
    assert manifest.losses["lost"] == missing
    assert manifest.losses["slow_lost"] == 60 + 60 + 1
    for name in ("rate", "temperature", "frequency", "supply"):
        held = np.isfinite(after[name])
        assert np.array_equal(after["time"][held], before["time"][~gone & np.isfinite(before[name])])
    means = pq.read_table(copy.means).to_pandas()
    counts = means.set_index("time")["rate_count"]
    assert (counts[39.5], counts[40.5], counts[41.5]) == (500, 1, 399)


def test_a_corrupt_frame_is_a_gap_and_is_counted(copy):
    frames = frames_of(copy).copy()
    rates = np.flatnonzero(frames["id"] == ID["GYRO_RATE"])
    frames["data"][rates[1000], 2] ^= 1
    rewrite(copy, frames)
    manifest = assemble(copy)
    assert (manifest.losses["corrupt"], manifest.losses["lost"]) == (1, 1)
    assert np.count_nonzero(np.isfinite(table(copy)["rate"])) == len(rates) - 1


def test_damage_in_the_journal_of_a_run_costs_only_its_block(copy):
    path = copy.journal / "can0.gtbj"
    rewrite(copy, frames_of(copy), block=602)  # as it was written: a second in a block
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    manifest = assemble(copy)
    assert manifest.losses["lost"] == pytest.approx(500, abs=1)
    assert path.read_bytes() == data  # kept as it is, to be looked at
    assert 14_000 < manifest.losses["journal_damaged_bytes"] < 15_000


def test_the_journals_of_a_run_that_has_ended_are_packed_and_the_manifest_has_their_hashes(short_run):
    for name in ("journal/can0.gtbj", "journal/bench.gtbj"):
        assert {block.kind for block in stored_blocks(short_run.path / name)} == {Kind.PACKED}
        assert short_run.manifest().files[name] == sha256(short_run.path / name)
    raw = len(frames_of(short_run)) * FRAME.itemsize
    assert (short_run.journal / "can0.gtbj").stat().st_size < raw / 5


def test_samples_are_kept_as_the_integers_of_the_wire(short_run):
    schema = pq.read_schema(short_run.data)
    field = schema.field("rate_code")
    assert (field.type, field.metadata[b"unit"]) == ("int32", b"deg/h")
    encodings = pq.read_metadata(short_run.data).row_group(0).column(1).encodings
    assert "DELTA_BINARY_PACKED" in encodings
    codes = pq.read_table(short_run.data)["rate_code"].to_numpy()
    scale, offset, factor = (float(field.metadata[name]) for name in (b"scale", b"offset", b"factor"))
    assert np.array_equal((codes * scale + offset) * factor, table(short_run)["rate"], equal_nan=True)
    assert {"temperature_code", "frequency_code", "chamber_temperature", "time"} < set(schema.names)


def test_a_run_of_an_older_bench_opens_and_gives_the_same_tables(short_run, copy, monkeypatch):
    """Journals in plain blocks, samples as numbers."""
    rewrite(copy, frames_of(copy), block=602)
    with monkeypatch.context() as patch:
        patch.setattr(bench.acquisition.recording.tables, "MOST_BITS", 0)
        assemble(copy, keep=True)
    assert {block.kind for block in stored_blocks(copy.journal / "can0.gtbj")} == {Kind.FRAMES}
    assert pq.read_schema(copy.data).names[:3] == ["time", "rate", "temperature"]
    assert pq.read_table(copy.means).equals(pq.read_table(short_run.means))
    older, newer = table(copy), table(short_run)
    assert older.keys() == newer.keys()
    for name, column in older.items():
        assert np.array_equal(column, newer[name], equal_nan=True)


def test_row_groups_change_nothing(short_run, copy, monkeypatch):
    monkeypatch.setattr(bench.acquisition.recording.assemble, "FRAMES_AT_ONCE", 600)
    monkeypatch.setattr(bench.acquisition.recording.tables, "ROWS_PER_GROUP", 5000)
    assemble(copy)
    assert pq.ParquetFile(copy.data).num_row_groups > 8
    assert pq.read_table(copy.data).equals(pq.read_table(short_run.data))


def test_a_unit_that_falls_silent_keeps_its_chamber_readings(copy, monkeypatch):
    monkeypatch.setattr(bench.acquisition.recording.assemble, "FRAMES_AT_ONCE", 600)
    monkeypatch.setattr(bench.acquisition.recording.tables, "ROWS_PER_GROUP", 5000)
    frames = frames_of(copy)
    silent = frames["t_ns"] >= 60_000_000_000
    foreign = frames.copy()
    foreign["id"][silent] += 1  # only a neighbour goes on
    rewrite(copy, foreign)
    assemble(copy)
    data = table(copy)
    assert np.all(np.diff(data["time"]) > 0)
    assert data["time"][np.isfinite(data["rate"])][-1] == pytest.approx(59.998)
    assert np.count_nonzero(np.isfinite(data["chamber_temperature"])) == len(readings_of(copy))


def test_a_run_without_a_single_frame_still_has_its_tables(copy):
    rewrite(copy, np.zeros(0, FRAME))
    manifest = assemble(copy)
    assert manifest.rows == 0
    assert pq.read_table(copy.data).num_rows == pq.read_table(copy.means).num_rows == 0


def test_what_a_capture_had_to_say_is_among_the_events(copy):
    writer = JournalWriter(copy.journal / "can0.gtbj")
    writer.append(Kind.EVENT, json.dumps({"kind": "capture", "text": "bus failed"}).encode(), 1, 50.0)
    writer.close()
    assemble(copy)
    events = list(copy.events())
    assert [event["t_s"] for event in events] == sorted(event["t_s"] for event in events)
    assert {"t_s": 50.0, "kind": "capture", "text": "bus failed"} in events


def test_how_a_capture_kept_up_is_in_the_manifest_and_no_news_is_no_event(copy):
    assert assemble(copy).capture is None
    before = len(list(copy.events()))
    writer = JournalWriter(copy.journal / "can0.gtbj")
    counts = {"error_frames": 0, "unreadable": 0, "recoveries": 0}
    spell = {"kind": "capture", "text": "the capture is 0.31 s behind its bus", "most_behind_ms": 310}
    end = {"kind": "capture", "text": "", **counts, "most_behind_ms": 900, "behind_spells": 2}
    for said in (spell, end, {**end, "behind_spells": 0, "most_behind_ms": 20, "no_news": 1}):
        writer.append(Kind.EVENT, json.dumps(said).encode(), 1, 50.0)
    writer.close()
    assert assemble(copy).capture.content() == {"most_behind_s": 0.9, "behind_spells": 2, **counts}
    assert len(list(copy.events())) == before + 2


def test_assembling_again_gives_the_same_run(short_run, copy):
    manifest = assemble(copy)
    assert manifest.files == short_run.manifest().files
    assert manifest.state == "done"


def test_a_folder_without_journals_is_refused(tmp_path):
    with pytest.raises(InputError, match="no manifest and no readable journal"):
        assemble(RunFolder(tmp_path))
