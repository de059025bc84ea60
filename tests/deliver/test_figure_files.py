"""`bench report --figures`: pictures as SVG and PNG with the numbers behind them; the run folder stays as it is."""

from __future__ import annotations

import json
from unittest.mock import patch
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from numpy.polynomial import Chebyshev, chebyshev
from PIL import Image

from tests.support.commands import bench
from tests.support.run_folders import make_run, ramp_run


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A run with a loop, its figures, and what the run folder held before."""
    folder = tmp_path_factory.mktemp("figures")
    run = make_run(folder / "run", **ramp_run())
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    done = bench("report", run, "--figures", folder / "out", "--model", "polynomial", "--model", "spline", "--json")
    return run, folder / "out", before, done


def table(folder, name: str) -> pd.DataFrame:
    return pd.read_csv(folder / f"{name}.csv")


def test_each_picture_comes_as_svg_and_png_with_its_data(drawn):
    run, out, before, done = drawn
    assert done.exit_code == 0
    names = {path.stem for path in out.iterdir()}
    models = {f"{model}_over_{what}" for model in ("polynomial", "spline") for what in ("time", "temperature")}
    assert names == {"profile", "bias_over_temperature", "spline_pieces", *models}
    assert {path.suffix for path in out.iterdir()} == {".svg", ".png", ".csv"}
    assert sorted(json.loads(done.stdout)["files"]) == sorted(str(path) for path in out.iterdir())
    for name in names:
        assert ElementTree.parse(out / f"{name}.svg").getroot().tag.endswith("svg")
        image = Image.open(out / f"{name}.png")
        picture = np.asarray(image.convert("L"))
        assert (picture.shape[1], round(image.info["dpi"][0])) == (1890, 300)  # 160 mm
        assert 0.005 < np.mean(picture < 200) < 0.5  # something is drawn
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_the_numbers_are_those_of_numpy(drawn):
    out = drawn[1]
    data = table(out, "polynomial_over_time")
    cubic = Chebyshev.fit(data.temperature_degC, data.model_dph, 3)(data.temperature_degC)
    assert np.abs(data.model_dph - cubic).max() < 1e-5
    least = data.bias_dph - Chebyshev.fit(data.temperature_degC, data.bias_dph, 3)(data.temperature_degC)
    assert 1.0 - 1e-6 < data.residual_dph.std() / least.std() < 1.2  # theirs does not weigh by the noise
    assert np.allclose(data.residual_dph, data.bias_dph - data.model_dph, atol=1e-6)
    pieces = table(out, "spline_pieces")
    curve = pieces[pieces.series != "measured"].sort_values("temperature_degC")
    model = table(out, "spline_over_time").sort_values("temperature_degC")
    assert (
        np.abs(np.interp(model.temperature_degC, curve.temperature_degC, curve.bias_dph) - model.model_dph).max() < 0.01
    )


def test_the_same_run_gives_the_same_bytes(drawn, tmp_path):
    run, out, _, _ = drawn
    bench("report", run, "--figures", tmp_path, "--model", "polynomial")
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (out / path.name).read_bytes(), path.name


def test_a_run_on_a_table_has_both_surfaces_and_both_ways_through_them(tmp_path):
    made = ramp_run(loop_dph=0.0)
    columns = made["columns"]
    rate = 20.0 * np.round(5 * np.sin(columns["time"] / 400.0))
    columns["applied_rate"] = rate
    columns["rate"] = columns["rate"] + 3600.0 * rate * (1.0 + 1e-3 + 2e-5 * (columns["temperature"] - 25.0))
    run = make_run(tmp_path / "run", **made)
    assert bench("report", run, "--figures", tmp_path / "out", "--model", "rate_surface").exit_code == 0
    measured = table(tmp_path / "out", "surface_measured")
    # The same surface by another basis and solver: products of Chebyshev polynomials of total degree 5.
    raw, celsius = measured.rate_dps + measured.measured_dph / 3600.0, measured.temperature_degC
    u, v = (2 * (x - x.min()) / np.ptp(x) - 1 for x in (raw, celsius))
    total = np.add.outer(np.arange(6), np.arange(6)).ravel() <= 5
    basis = chebyshev.chebvander2d(u, v, [5, 5])[:, total]
    other = 3600.0 * (raw - basis @ np.linalg.lstsq(basis, measured.rate_dps, rcond=None)[0])
    assert np.abs(other - measured.fitted_dph).max() < 1e-3
    fixed_t = table(tmp_path / "out", "varied_rate_at_fixed_temperatures")
    fixed_rate = table(tmp_path / "out", "varied_temperature_at_fixed_rates")
    assert set(np.round(fixed_rate.rate_dps)) == set(20.0 * np.arange(-5, 6))
    assert len(fixed_t) > 0
    assert (tmp_path / "out" / "surface_fitted.png").stat().st_size > 50_000


def test_what_it_cannot_do_is_refused_in_one_line(drawn, tmp_path):
    run = drawn[0]
    done = bench("report", run, "--figures", tmp_path, "--check", run)
    assert (done.exit_code, "takes no --check, --sister or --limits" in done.output) == (2, True)
    with patch("bench.deliver.report.figure_files.find_spec", return_value=None):
        done = bench("report", run, "--figures", tmp_path, "--model", "polynomial")
    assert (done.exit_code, "matplotlib" in done.stderr) == (2, True)
    assert not list(tmp_path.iterdir())
