"""A record to work with: a run folder, somebody else's table, or a DataFrame, opened once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from bench import acquisition, analysis, commands, deliver, record
from bench.api.models import ModelLike, fitted_model
from bench.api.words import floor_text, html, no_xarray
from bench.base import CHANNELS, clock, number
from bench.record import DEFAULT_INTERVAL_S, Dataset

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go
    import xarray as xr

    from bench.analysis import Floor
    from bench.api.comparison import Comparison
    from bench.api.diagnosis import Diagnosis
    from bench.api.fits import Fit

Over: TypeAlias = Literal["temperature", "time"]


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """One record of one unit; `bench.open` and `bench.run` make it.

    All numbers rest on means over `interval_s` [s], as those of the command line do.
    """

    name: str
    interval_s: float
    """Length of the means [s]: 30, or the distance of the rows where a table has them further apart."""
    folder: Path | None
    """Run folder; None for a table or a DataFrame."""
    finest_s: float
    """Length of the shortest means that the noise is read from [s]: 1, or the distance of the rows of a slow table."""
    _read: Callable[[float], Dataset]

    @cached_property
    def dataset(self) -> Dataset:
        """Means over `interval_s`: channels, `bias`, `dT_dt` and `direction` as arrays (n,), NaN in gaps."""
        return self._read(self.interval_s)

    @cached_property
    def seconds(self) -> Dataset:
        """Means over one second, or the rows themselves where they are further apart; the noise is read from these."""
        return self._read(self.finest_s)

    @cached_property
    def floor(self) -> Floor:
        """Noise floor: the RMS [deg/h] that the best possible model would leave, read where the temperature stands.

        `floor.floor_dph` is NaN and `floor.reason` says why where the record never stands still.
        """
        return analysis.noise_floor([self.seconds], self.interval_s)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the record by their names in `bench.channels`."""
        return tuple(self.dataset.channels)

    def fit(self, model: ModelLike, *, check: Runs = (), static: Run | None = None, **options: object) -> Fit:
        """Fit a model to this run.

        `model` is the name of a shipped model or effect, a YAML file, a `bench.Model`, an effect or another fit;
        `options` are those of the effect, such as `order=5` of "polynomial". `check` are runs that the fit does not
        see and that its held-out error is of; `static` is a run at constant temperature that tells the noise floor.

        Raises InputError: an unknown model, effect or option, a channel that is missing or constant, or a model that
        these rows do not determine.
        """
        from bench.api.fits import fit

        return fit(self, fitted_model(model, options), check=check, static=static)

    def compare(self, models: Sequence[ModelLike] = (), *, check: Runs = (), static: Run | None = None) -> Comparison:
        """Models side by side on this run, see `bench.compare`."""
        from bench.api.comparison import compare

        return compare(self, models, check=check, static=static)

    def diagnose(
        self, model: ModelLike, *, check: Runs = (), static: Run | None = None, sisters: Runs = ()
    ) -> Diagnosis:
        """Where a model fails and which physical effect it lacks, see `bench.diagnose`."""
        from bench.api.diagnosis import diagnose

        return diagnose(self, model, check=check, static=static, sisters=sisters)

    def to_dataframe(self, interval_s: float | None = None) -> pd.DataFrame:
        """Channels, `bias` [deg/h] and `segment` as columns, one row a mean over `interval_s` [s] (default: the run's).

        The index is `time` [s]; units stand in `attrs["units"]`. Raises InputError for means shorter than the rows.
        """
        import pandas as pd

        dataset = self.dataset if interval_s is None else self._read(interval_s)
        columns = {**dataset.channels, "bias": dataset.bias, "segment": dataset.segment}
        frame = pd.DataFrame(columns, index=pd.Index(dataset.time, name="time"))
        units = {name: CHANNELS[name].unit for name in dataset.channels}
        frame.attrs["units"] = {"time": "s", **units, "bias": "deg/h"}
        return frame

    def to_xarray(self, interval_s: float | None = None) -> xr.Dataset:
        """The same as an `xarray.Dataset` over `time`, each variable with its units and meaning.

        Raises InputError where xarray is not installed.
        """
        try:
            import xarray as xr
        except ImportError:
            raise no_xarray() from None
        frame = self.to_dataframe(interval_s)
        found: xr.Dataset = xr.Dataset.from_dataframe(frame)
        for name, unit in frame.attrs["units"].items():
            known = CHANNELS.get(name)
            meaning = "rate less what the rate table turned" if known is None else known.meaning
            found[name].attrs.update(units=unit, long_name=meaning)
        found.attrs["run"] = self.name
        return found

    def plot(self, over: Over = "temperature") -> go.Figure:
        """Bias [deg/h] over temperature, coloured by time; or bias and temperature over "time"."""
        from bench.api.words import figure

        return figure(
            deliver.loop_figure(self.dataset) if over == "temperature" else deliver.measured_figure(self.dataset)
        )

    def summary(self) -> str:
        """Name, length, ranges of the channels, segments and noise floor, as text."""
        lines = [self._headline(), ""]
        lines += [f"  {name:<20} {low:>10} to {high} {unit}" for name, low, high, unit in self._ranges()]
        return "\n".join([*lines, "", self._noise()])

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._headline()}>"

    def _repr_html_(self) -> str:
        rows = [(name, f"{low} to {high}", unit) for name, low, high, unit in self._ranges()]
        return html(self._headline(), "Channels", ("channel", "range", "unit"), rows, self._noise())

    def _headline(self) -> str:
        data = self.dataset
        length = clock(float(data.time[-1] - data.time[0]))
        return f"{self.name}: {len(data)} means over {self.interval_s:g} s, {length} h, {len(data.segments)} segments"

    def _noise(self) -> str:
        return floor_text(self.floor)

    def _ranges(self) -> list[tuple[str, str, str, str]]:
        import numpy as np

        shown = {"bias": (self.dataset.bias, "deg/h")} | {
            name: (values, CHANNELS[name].unit) for name, values in self.dataset.channels.items()
        }
        return [
            (name, number(float(np.nanmin(values)), 4), number(float(np.nanmax(values)), 4), unit)
            for name, (values, unit) in shown.items()
            if np.any(np.isfinite(values))
        ]


Runs: TypeAlias = Run | Sequence[Run]
"""One run, or several of the same unit."""


def several(runs: Runs) -> tuple[Run, ...]:
    """The runs as a tuple."""
    return (runs,) if isinstance(runs, Run) else tuple(runs)


def floor_of(runs: Sequence[Run], static: Run | None) -> Floor:
    """Noise floor of the means of these runs."""
    if static is None and len(runs) == 1:
        return runs[0].floor
    fine = [run.seconds for run in runs]
    return analysis.noise_floor(fine, runs[0].interval_s, None if static is None else static.seconds)


def open(
    source: str | Path | pd.DataFrame,
    columns: Mapping[str, str] | str | Path | None = None,
    units: Mapping[str, str] | None = None,
    *,
    interval_s: float = DEFAULT_INTERVAL_S,
    dbc: str | Path | None = None,
    output: str | None = None,
) -> Run:
    """Open a run folder, a table (CSV, Parquet, MF4, or a CAN log with its `dbc`) or a DataFrame.

    `columns` names the column of each channel that its header does not make obvious, `{"rate": "gz", "temperature":
    "T_int"}`, or is the YAML file of `bench import --columns`; `units` are those of the channels, `{"rate": "deg/s"}`,
    where the header does not say them. Every value is converted into the unit in `bench.channels`. `interval_s` [s] is
    the length of the means that models are fitted to; `output` ("rate_x") is the rate that is looked at, of a unit with
    several. Nothing is written.

    Raises InputError, one line with file and line: no such file, a channel that no column is, an unknown unit, time
    that runs backwards, or a run that was never finished.

    >>> import bench, numpy as np, pandas as pd
    >>> t = np.arange(0.0, 7200.0)
    >>> temperature = 25.0 + 20.0 * np.sin(t / 1000.0)
    >>> frame = pd.DataFrame({"t": t, "T": temperature, "gz": 0.001 + 1e-5 * temperature})
    >>> run = bench.open(frame, {"time": "t", "rate": "gz", "temperature": "T"}, {"rate": "deg/s"})
    >>> run.channels
    ('rate', 'temperature')
    >>> round(float(run.dataset.bias.mean()), 1)  # [deg/h]
    4.5
    """
    if isinstance(source, str | Path) and Path(source).is_dir():
        return open_folder(Path(source), interval_s, output)
    base = _foreign(source, columns, units or {}, dbc)
    base = base if output is None else base.of(output)
    return Run(base.name, max(interval_s, base.interval_s), None, max(1.0, base.interval_s), base.average)


def open_folder(folder: Path, interval_s: float = DEFAULT_INTERVAL_S, output: str | None = None) -> Run:
    """The run in a folder; one whose bench was killed is recovered from its journals first."""
    path = commands.recover(folder).path

    def read(wanted_s: float) -> Dataset:
        return record.load(path, wanted_s, output)

    return Run(record.load(path, interval_s, output).name, interval_s, path, 1.0, read)


def _foreign(source: Any, columns: Any, units: Mapping[str, str], dbc: str | Path | None) -> Dataset:
    stated = acquisition.load_columns(columns) if isinstance(columns, str | Path) else None
    encoding = None if stated is None else stated.encoding
    table = (
        acquisition.read_table(source, dbc, encoding=encoding)
        if isinstance(source, str | Path)
        else acquisition.table_of(source)
    )
    chosen: acquisition.ColumnMap = stated or acquisition.column_map(
        table, {} if isinstance(columns, str | Path) else columns or {}, units
    )
    return acquisition.plan_table(table, chosen, "unknown").dataset()
