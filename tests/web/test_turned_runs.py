"""The workbench on the run of a unit that a rate table turned: its first model is judged beside a scale factor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import numpy as np

from bench.web.ground.settings import Settings
from tests.support.run_folders import make_run, ramp_run
from tests.support.web_client import served
from tests.web.test_workbench import SPLINE, done

ERROR_PPM = 300.0


def made(out: Path, name: str, *, turned: bool) -> str:
    """A ramp, in which the unit is turned at two rates both ways every hour, or stands still on its table."""
    run = ramp_run()
    time = run["columns"]["time"]
    applied = np.array([0.0] * 20 + [40.0, -40.0, 20.0, -20.0])[(time // 120.0).astype(int) % 24] * turned
    run["columns"]["applied_rate"] = applied
    run["columns"]["rate"] = run["columns"]["rate"] + 3600.0 * applied * (1.0 + 1e-6 * ERROR_PPM)
    folder = make_run(out / "SIM-0001" / name, **run)
    return f"SIM-0001/{folder.name}"


def first(client: httpx.Client, run: str) -> dict[str, Any]:
    assert client.get(f"/api/v1/runs/{run}").json()["table"]
    return done(client, "/analyses", {"runs": [run], "models": [SPLINE], "turning": True})


def test_the_first_model_of_a_turned_unit_has_a_scale_factor(tmp_path: Path) -> None:
    turned, still = (made(tmp_path, f"20261121T0{hour}0000Z_ramp", turned=hour == 6) for hour in (6, 8))
    with served(Settings(tmp_path)) as client:
        plain = done(client, "/analyses", {"runs": [turned], "models": [SPLINE]})
        found, resting = first(client, turned), first(client, still)
    assert (plain["turned"], found["turned"], resting["turned"]) == (False, True, False)
    effects = [[one["effect"] for one in answer["models"][0]["model"]["effects"]] for answer in (found, resting)]
    assert effects == [["spline", "scale_factor_temperature", "scale_factor_nonlinearity"], ["spline"]]
    assert found["rungs"][0]["rms_dph"] < 0.1 * plain["rungs"][0]["rms_dph"]
