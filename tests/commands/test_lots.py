"""One calibration for a lot: what each unit loses by it, its delivery, and units that are refused it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.analysis.judging.likeness import Cells, likeness
from bench.analysis.judging.lot import calibrate_lot
from bench.base.errors import InputError
from benchmarks import lots
from tests.support.commands import bench
from tests.support.run_folders import make_run

UNITS = 12


def run_of(folder, record):
    """A run folder of a simulated unit."""
    columns = {"time": record.time, **record.channels, "segment": np.zeros(len(record))}
    segment = {"index": 0, "name": "all", "kind": "ramp", "from_s": 0.0, "to_s": float(record.time[-1])}
    return make_run(folder / record.unit, columns, [segment], unit=record.unit, simulated=True)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs of twelve units, and the folder of their lot."""
    folder = tmp_path_factory.mktemp("lots")
    random = np.random.default_rng(5)
    runs = [run_of(folder, lots.record(lots.member(random), f"G-{i:03d}", 500 + i)) for i in range(UNITS)]
    done = bench("lot", "calibrate", "LOT-7", *runs, "--model", "polynomial", "--out", folder / "out", "--json")
    assert done.exit_code == 0, done.output
    return folder, runs, json.loads(done.stdout)


def test_leaving_a_unit_out_is_fitting_without_it():
    random = np.random.default_rng(1)
    records = [lots.record(lots.member(random), f"U{i}", i) for i in range(4)]
    found = calibrate_lot(lots.load_model("polynomial"), records)
    for i, loss in enumerate(found.losses):
        others = [record for k, record in enumerate(records) if k != i]
        x, y = (np.concatenate([v(r) for r in others]) for v in (lambda r: r.channel("temperature"), lambda r: r.bias))
        own_x, own_y = records[i].channel("temperature"), records[i].bias
        left = own_y - np.polynomial.Polynomial.fit(x, y, 3)(own_x)
        mine = own_y - np.polynomial.Polynomial.fit(own_x, own_y, 3)(own_x)
        assert loss.lot_rms_dph == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-9)
        assert loss.levelled_rms_dph == pytest.approx(left.std(), rel=1e-9)
        assert loss.own_rms_dph == pytest.approx(np.sqrt(np.mean(mine**2)), rel=1e-9)


def test_units_of_the_lot_are_accepted_and_others_refused():
    lot = lots.lot_of(30)
    assert lots.refused(lot, None, 30, 3) <= 0.05
    for kind in lots.UNLIKE:
        assert lots.refused(lot, kind, 8, 4) == 1.0, kind


def test_a_knee_is_noticed_where_units_differ_mostly_by_their_constants():
    random, cells = np.random.default_rng(6), Cells.over(-38.0, 84.0)

    def units(kind, count):
        own = [replace(lots.member(random), constant_dph=random.normal(0.0, 8.0)) for _ in range(count)]
        changed = own if kind is None else [lots.UNLIKE[kind](unit, random) for unit in own]
        return [cells.means([lots.record(unit, "X", int(random.integers(1 << 40)))]) for unit in changed]

    table = np.array(units(None, 30))
    knees = likeness(table, cells, units("a resonance crosses (knee of 1 deg/h)", 8))
    assert not any(one.like for one in knees)
    assert sum(not one.like for one in likeness(table, cells, units(None, 40))) <= 3


def test_a_few_cells_suffice_and_fewer_are_refused():
    lot = lots.lot_of(12)
    unit = lot.table[0].copy()
    unit[6:] = np.nan
    assert likeness(lot.table, lot.cells, [unit])[0].cells == 6
    unit[3:] = np.nan
    with pytest.raises(InputError, match=r"3 cells of temperature in common .* heat or cool the unit"):
        likeness(lot.table, lot.cells, [unit])


def test_the_lot_is_a_run_folder_that_is_exported_as_others_are(made):
    folder, _, answer = made
    assert answer["loss"]["own_rms_dph"]["median"] < answer["loss"]["lot_rms_dph"]["median"]
    assert len(answer["units"]) == UNITS
    done = bench("export", answer["run"], "--format", "json", "--out", folder / "export", "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["unit"] == "LOT-7"


def test_its_calibration_is_not_replaced_by_one_of_its_rows(made):
    _, _, answer = made
    before = Path(answer["run"], "calibration.json").read_bytes()
    for command in ("report", "replay"):
        done = bench(command, answer["run"])
        assert (done.exit_code, "was calibrated by its lot" in done.stderr) == (2, True)
    assert Path(answer["run"], "calibration.json").read_bytes() == before


def test_a_unit_gets_it_only_when_a_run_shows_that_it_is_like_the_lot(made):
    folder, runs, answer = made
    like = bench("lot", "check", answer["run"], *runs[:2])
    assert (like.exit_code, "UNLIKE" in like.stdout) == (0, False)
    random = np.random.default_rng(8)
    turned = lots.UNLIKE["mounted the wrong way round"](lots.member(random), random)
    other = run_of(folder, lots.record(turned, "SIM-0001", 9))
    done = bench("lot", "check", answer["run"], other, "--json")
    assert (done.exit_code, json.loads(done.stdout)["units"][0]["like"]) == (1, False)
    words = ["flash", "SIM-0001", "--run", answer["run"], "--out", folder / "out", "--quiet"]
    assert "show with --check RUN" in bench(*words).stderr
    refused = bench(*words, "--check", other)
    assert (refused.exit_code, "unlike its lot" in refused.stderr) == (2, True)
    good = run_of(folder / "good", lots.record(lots.member(random), "SIM-0001", 10))
    flashed = bench(*words, "--check", good, "--json")
    assert flashed.exit_code == 0, flashed.output
    assert json.loads(flashed.stdout)["state"] == "done"


def test_lots_that_are_none_are_refused(made):
    _, runs, _ = made
    done = bench("lot", "calibrate", "L", *runs[:2], "--model", "polynomial")
    assert (done.exit_code, "at least 3 units" in done.stderr) == (2, True)
    done = bench("lot", "calibrate", "L", *runs, "--model", "cubic-soaks")
    assert done.exit_code == 2
    done = bench("lot", "check", runs[0], runs[1])
    assert (done.exit_code, "lot.json is missing" in done.stderr) == (2, True)
