"""A unit with several outputs in the page: its run is measured, and the workbench looks at one output at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest

import bench
from bench.analysis import analyse
from bench.base import InputError
from bench.web.ground.settings import Settings
from tests.support.run_folders import make_run, ramp_run
from tests.support.web_client import served

AXES = ["rate_x", "rate_y", "rate_z"]
LINE = {"name": "line", "effects": [{"effect": "polynomial", "order": 1}]}


def made(out: Path, *, stood: bool = False) -> Path:
    """The run of a unit whose axes differ by their hysteresis; `stood`: in two attitudes."""
    runs = [ramp_run(loop_dph=loop, seed=seed) for seed, loop in enumerate((0.0, 0.4, 0.8))]
    columns = {name: values for name, values in runs[0]["columns"].items() if name != "rate"}
    columns |= {axis: run["columns"]["rate"] for axis, run in zip(AXES, runs, strict=True)}
    segments = runs[0]["segments"]
    if stood:
        segments = [{**one, "attitude": ("z_up", "x_up")[number % 2]} for number, one in enumerate(segments)]
    return make_run(out / "IMU-7" / "20261121T060000Z_ramp", columns, segments, unit="IMU-7")


def asked(client: httpx.Client, path: str, body: dict[str, Any]) -> dict[str, Any]:
    job = client.post(f"/api/v1{path}", json=body).json()["job"]
    while True:
        answer = client.get(f"/api/v1/jobs/{job}", params={"wait_s": 20}).json()
        if answer["state"] in {"done", "failed"}:
            found: dict[str, Any] = answer
            return found


def test_the_workbench_looks_at_one_output_after_the_other(tmp_path: Path) -> None:
    folder = made(tmp_path)
    run = f"IMU-7/{folder.name}"
    with served(Settings(tmp_path)) as client:
        assert client.get(f"/api/v1/runs/{run}").json()["outputs"] == AXES
        of = {
            axis: asked(client, "/analyses", {"runs": [run], "models": [LINE], "output": axis})["result"]
            for axis in AXES
        }
        errors = [of[axis]["rungs"][0]["rms_dph"] for axis in AXES]
        assert sorted(set(errors)) == errors
        figure = {"runs": [run], "of": run, "kind": "time", "output": "rate_y"}
        assert asked(client, "/figures", figure)["state"] == "done"
        unsaid = asked(client, "/analyses", {"runs": [run], "models": [LINE]})
        assert (unsaid["state"], "choose one of rate_x, rate_y, rate_z" in unsaid["detail"]) == ("failed", True)
        notebook = client.post("/api/v1/notebooks", json={"runs": [run], "models": [LINE], "output": "rate_y"}).json()
        assert "bench.open(archive / run, output='rate_y')" in "".join(notebook["cells"][1]["source"])
    assert bench.open(folder, output="rate_z").fit("polynomial", order=1).rms_dph == pytest.approx(errors[2])


def test_a_run_of_several_outputs_is_measured_and_not_empty(tmp_path: Path) -> None:
    analysis = analyse(made(tmp_path))
    assert (analysis.verdict.word, analysis.done.missing_ppm) == ("measured", 0.0)
    assert "the unit has 3 outputs" in analysis.verdict.sentence


def test_an_axis_of_a_run_in_several_attitudes_is_not_fitted_alone(tmp_path: Path) -> None:
    run = bench.open(made(tmp_path, stood=True), output="rate_x")
    with pytest.raises(InputError, match=r"stood in 2 attitudes.*`bench imu` fits all axes"):
        run.fit("polynomial")
