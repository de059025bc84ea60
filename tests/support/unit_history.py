"""A unit with a history: calibrations over months, one aborted run, certificates, and a write into its memory."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

from bench.record import Manifest
from tests.support.fleet_runs import BEGIN
from tests.support.run_folders import keep

UNIT = "GX-0042"
PDF = b"%PDF-1.4\n%a certificate\n"
DAYS = (0, 31, 95, 140, 201, 250)
ABORTED, CERTIFIED, WRITTEN = 2, (1, 3), 3


def unit_with_history(root: Path) -> list[Path]:
    """Run folders of `UNIT` in order of time; the third was aborted, the fourth is in the unit."""
    return [_run(root, number, days) for number, days in enumerate(DAYS)]


def _run(root: Path, number: int, days: int) -> Path:
    created = BEGIN + timedelta(days=days)
    folder = root / UNIT / f"{created:%Y%m%dT%H%M%SZ}_ramp_-40_85"
    folder.mkdir(parents=True)
    whole = number != ABORTED
    Manifest.model_validate({
        "unit": UNIT, "run": folder.name, "profile": "ramp_-40_85", "station": "chamber-1",
        "operator": ("O. Koval", "M. Li")[number % 2], "created": created.isoformat(), "simulated": False,
        "state": "done" if whole else "aborted", "cause": "end of profile" if whole else "guard: chamber temperature",
        "duration_s": 30240.0 if whole else 5400.0,
    }).write(folder)  # fmt: skip
    if not whole:
        return folder
    _calibrate(folder, number)
    if number in CERTIFIED:
        facts = {
            "number": f"{UNIT}-{created:%Y%m%d}-A1B2C3D{number}",
            "verdict": "PASS",
            "issued": f"{created:%Y-%m-%d}",
        }
        keep(folder, "certificate.json", facts)
        (folder / "certificate.pdf").write_bytes(PDF)
    if number == WRITTEN:
        record = {
            "utc": created.isoformat(), "operator": "O. Koval", "calibration_id": "0x87323979", "bank": 2,
            "state": "done", "coefficient_set": 7, "crc": "0x17FED789", "new": {"words": 115},
            "run": f"/elsewhere/{folder.name}", "old": {"calibration_id": "0x1144AA07"},
        }  # fmt: skip
        flash = root / UNIT / "flash"
        flash.mkdir()
        keep(flash, f"{created:%Y%m%dT%H%M%SZ}.json", record)
    return folder


def _calibrate(folder: Path, number: int) -> None:
    residual = 0.12 + 0.016 * number
    judged = "PASS" if residual < 0.19 else "FAIL"
    content = {
        "verdict": {"verdict": "adequate"},
        "noise": {"floor_dph": 0.1 + 0.002 * number,
                  "coefficients": [{"name": "white", "value": 0.01, "determined": True}]},
        "residual": {"rms_dph": residual * 0.9, "held_out": [{"by": "blocks", "rms_dph": residual}]},
        "calibration": {"model": {"name": "spline_lag_loop"}, "parameters": [],
                        "coefficients": [{"key": "spline.c0", "value": float(number)}],
                        "validity": {"temperature": {"from": -39.0 + number, "to": 84.0, "unit": "degC"}}},
    }  # fmt: skip
    keep(folder, "calibration.json", content)
    result = {
        "name": "residual_rms_dph",
        "unit": "deg/h",
        "value": residual,
        "lower": None,
        "upper": 0.19,
        "verdict": judged,
    }
    keep(folder, "limits.json", {"name": "vibratory", "verdict": judged, "results": [result]})
