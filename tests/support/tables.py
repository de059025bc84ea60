"""Foreign tables to import, for every test of the importer."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.acquisition.importer.columns import ColumnMap, TimeSource
from bench.acquisition.importer.plan import plan_table
from bench.acquisition.importer.tables import read_table
from bench.base.errors import InputError

DBC = Path(__file__).parents[2] / "drivers" / "gyros" / "vibratory.dbc"
COUNTED = ColumnMap(time=TimeSource(interval_s=1.0))


def write(tmp_path, text, name="table.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def refusal(path, columns=None, **options):
    with pytest.raises(InputError) as caught:
        imported(path, columns, **options)
    text = str(caught.value)
    assert "\n" not in text, "one clear line"
    assert str(path) in text
    return text.replace(str(path), "FILE")


def loop(rows=1200, seconds=20.0):
    """A record 25 → -20 → 60 → 25 degC with a stand of an hour at the cold end: time, rate, temperature."""
    time = np.arange(rows) * seconds
    degc = np.interp(time, [0, 5000, 8600, 16000, 24000], [25, -20, -20, 60, 25])
    return time, 10 + 0.1 * degc, degc


TABLE = pd.DataFrame({"time": [0.0, 60.0, 120.0], "rate": [1.5, -2.25, np.nan], "temperature": [20.0, 21.5, 22.0]})


def imported(path, columns=None, serial="unknown", dbc=None):
    """The plan of an import, nothing written."""
    columns = columns or ColumnMap()
    return plan_table(read_table(path, dbc, encoding=columns.encoding), columns, serial)
