"""Certificates of a unit that was calibrated on a rate table."""

import json

import numpy as np
import pytest

from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse
from tests.deliver.test_certificate import LABORATORY, over
from tests.support.commands import bench
from tests.support.run_folders import make_run, ramp_run


def turned(run, rest_s=1200.0, rates=(0.0, 0.0, 60.0, -60.0, 120.0, -120.0)):
    """The run on a rate table that changes every three minutes after a rest; 50 ppm and 20 ppm/degC off."""
    columns = dict(run["columns"])
    rate = (columns["time"] > rest_s) * np.choose((columns["time"] // 180).astype(int) % len(rates), rates)
    error = 3600e-6 * rate * (50.0 + 20.0 * (columns["temperature"] - 25.0))
    return {**run, "columns": {**columns, "applied_rate": rate, "rate": columns["rate"] + error + 3600.0 * rate}}


TABLE = """\
equipment:
  - {name: chamber sensor, serial: PT-1, calibrated: 2026-03-01, due: 2027-03-01}
  - {name: rate table, serial: RT-1, calibrated: 2026-03-01, due: 2027-03-01, UNCERTAINTY}
"""


@pytest.mark.parametrize("stated", [True, False])
def test_under_rotation_u_is_that_of_the_rate_table_or_unknown(tmp_path, stated):
    run = make_run(tmp_path / "run", **turned(ramp_run(loop_dph=0.0)))
    analyse(run, [load_model("spline")], diagnose=False)
    check = make_run(tmp_path / "check", **turned(over(-30.0, 70.0, 2)), profile="check")
    what = "uncertainty: [{value: 10, unit: ppm}, {value: 0.05, unit: deg}]" if stated else "model: old"
    (tmp_path / "table.yaml").write_text(TABLE.replace("UNCERTAINTY", what))
    (tmp_path / "laboratory.yaml").write_text(LABORATORY)
    files = ["--equipment", tmp_path / "table.yaml", "--laboratory", tmp_path / "laboratory.yaml"]
    words = ["certificate", run, "--verification", check, *files, "--out", tmp_path / "c.pdf"]
    done = bench(*words)
    assert done.exit_code == 0, done.output
    facts = json.loads((tmp_path / "c.json").read_text())
    rows = {row["rate_dps"]: row for row in facts["uncertainty"]["by_rate"]}
    assert set(rows) == {60.0, 120.0}
    assert facts["as_found"]["rms_dph"] < 20 < facts["as_found"]["turning"]["rms_dph"]
    floor = next(one for one in facts["results"] if one["name"] == "noise_floor_dph")
    assert floor["value"] < 0.1
    scale = next(one for one in facts["results"] if one["name"] == "scale_factor_error_ppm")
    assert scale["value"] == pytest.approx(50.0, abs=1.0)
    if stated:
        table_dph = 10e-6 * 120.0 * 3600.0
        assert rows[120.0]["expanded_dph"] == pytest.approx(table_dph, rel=0.05)
        assert scale["high"] - scale["value"] == pytest.approx(10.0, rel=0.05)
    else:
        assert rows[120.0]["expanded_dph"] is None
        assert rows[120.0]["unknown"] == ["rate table", "alignment of the axes"]
        assert scale["high"] is None


def test_soaks_in_which_the_table_changes_its_rate_tell_no_noise(tmp_path):
    run = turned(ramp_run(loop_dph=0.0), rest_s=0.0)
    found = analyse(make_run(tmp_path / "run", **run), [load_model("spline")], diagnose=False)
    assert np.isnan(found.floor.floor_dph)
    assert "minutes at one rate to read the noise from" in found.floor.reason
