"""How people use `import bench`, for the type checker: CI's mypy reads this file, nothing runs it."""

from pathlib import Path
from typing import assert_type

import numpy as np
import pandas as pd
import xarray as xr

import bench


def from_a_folder_to_the_missing_effect(folder: Path) -> bench.Fit:
    run = bench.open(folder)
    fit = run.fit("spline", intervals=24)
    why = bench.diagnose([run, bench.open("another")], fit, check=run, static=run)
    if why.verdict == "missing_effect" and why.proved:
        fit = fit.add(why.found[0].effect, **why.found[0].options)
    fit.plot(run, over="time").show()
    return why.fit()


def from_a_table(frame: pd.DataFrame) -> dict[str, tuple[float, float]]:
    run = bench.open(frame, {"rate": "gz"}, {"rate": "deg/s"}, interval_s=10.0)
    fit = run.fit(bench.add("thermal_lag", bench.load_model("polynomial")))
    predicted = fit.predict(temperature=np.linspace(-40.0, 85.0, 100), time=np.arange(100.0))
    assert_type(predicted, bench.Prediction)
    assert_type(run.to_dataframe(60.0), pd.DataFrame)
    assert_type(run.to_xarray(), xr.Dataset)
    compared = run.compare(["polynomial", fit, "mine.yaml"])
    assert_type(compared["polynomial"], bench.Fit)
    assert_type(run.floor.floor_dph, float)
    return {key: (c.value, c.std) for key, c in fit.coefficients.items()}


def drive() -> bench.Run:
    try:
        bench.check("profiles/quick.yaml")
        return bench.run("profiles/quick.yaml", "station.yaml", unit="SIM-0001", onlooker=lambda s: print(s.t_s))
    except (bench.InputError, bench.RunAborted, bench.EquipmentError) as error:
        print(error, error.exit_code)
        raise
