"""The report of an inertial unit: everything that its record says, in one file, hostile names harmless."""

import json
import re

import numpy as np
import pytest

from bench.analysis.imu.stored import curves_of
from bench.deliver.report.imu_page import render_imu
from bench.record import ImuAxisError, ImuFinding, ImuVerificationRecord
from tests.support.imu_units import imu_record

HOSTILE = '</script><script>alert("x")</script>'


def figures(html):
    found = re.findall(r'<script type="application/json" id="([\w-]+)-data">(.*?)</script>', html, re.DOTALL)
    return {name: json.loads(text) for name, text in found}


@pytest.fixture(scope="module")
def page():
    return render_imu(imu_record())


def test_every_kind_of_parameter_is_drawn_over_temperature_with_its_u(page):
    drawn = figures(page)
    kinds = {"gyro": ("bias", "scale-factor", "misalignment", "g-sensitivity"),
             "accelerometer": ("bias", "scale-factor", "misalignment", "second-order")}  # fmt: skip
    assert set(drawn) == {f"{t}-{k}" for t, own in kinds.items() for k in own} | {
        "residual-gyro",
        "residual-accelerometer",
    }
    traces = drawn["gyro-g-sensitivity"]["data"]
    assert len(traces) == 3 * 3 * 3  # of each axis and input: band, value, U
    band, value, U = drawn["gyro-bias"]["data"][:3]
    middle = len(value["x"]) // 2
    estimate = next(e for e in curves_of(imu_record()).gyro.estimates([value["x"][middle]]))
    assert value["y"][middle] == pytest.approx(estimate.value, rel=1e-6)
    assert U["y"][middle] == pytest.approx(estimate.U, rel=1e-6)
    assert band["y"][middle] == pytest.approx(estimate.value - estimate.U, rel=1e-6)
    titles = [axis["title"]["text"] for key, axis in drawn["gyro-bias"]["layout"].items() if key.startswith("yaxis")]
    assert "bias [deg/h]" in titles


def test_all_parameters_and_residuals_stand_in_tables(page):
    record = imu_record()
    for value in record.parameters:
        assert f">{value.name.split(' ', 1)[1]}<" in page
    rms = float(np.sqrt(np.mean(np.square(record.gyro.axes[0].residual))))
    assert f">{rms:.2f}<" in page
    assert record.sources[0].sha256 in page
    assert "In order, not verified" in page


def test_findings_and_undetermined_parameters_head_the_report():
    finding = ImuFinding(
        cause="thermal_lag", where="gyro x", text=f"gyro x lacks {HOSTILE}", look_alikes=("hysteresis",)
    )
    record = imu_record().model_copy(
        update={"findings": (finding,), "undetermined": ("gyro z: bias: at 20 degC U = 3",), "simulated": True}
    )
    page = render_imu(record)
    assert "Do not use as it stands" in page
    assert "thermal lag (gyro x)" in page
    assert "not determined: 1 of the parameters" in page
    assert HOSTILE not in page
    assert "Simulated." in page


@pytest.mark.parametrize(("verdict", "headline"), [("PASS", ">In order<"), ("FAIL", "Do not use as it stands")])
def test_a_verification_stands_in_the_report(verdict, headline):
    axis = ImuAxisError(
        name="gyro x", unit="deg/h", raw_rms=400.0, rms=2.5, interval=(2.0, 3.0), mean=0.5, scatter=2.4, peak=8.0,
        floor=2.0, over_floor=1.25, stated=2.6,
    )  # fmt: skip
    verified = ImuVerificationRecord(
        created="2026-01-01T00:00:00+00:00", verdict=verdict, rows=100, stays=60, fitted_rows=3, rows_beyond=4,
        range_degc=(-20.0, 60.0), axes=(axis,), rule="as stated",
    )  # fmt: skip
    page = render_imu(imu_record(), verified)
    assert headline in page
    assert f"{verdict}: 100 rows of 60 stays" in page
    assert ">2.00 to 3.00<" in page
