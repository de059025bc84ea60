"""What summaries and notebooks show: tables, errors beside the noise floor, figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from bench import deliver
from bench.base import InputError, finite, number

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from bench.analysis import Floor
    from bench.deliver import Plot


def floor_text(floor: Floor) -> str:
    """The noise floor as a sentence; why it is not known where it is not."""
    if finite(floor.floor_dph) is None:
        return f"noise floor not known: {floor.reason}"
    return f"noise floor {number(floor.floor_dph)} deg/h RMS"


def errors_text(rms_dph: float, held_out_dph: float, by: str, floor: Floor, reason: str = "") -> str:
    """An error in the fitted rows, on unseen ones (or the reason why there is none), and the floor beside them."""
    outside = f"{number(held_out_dph)} (by {by})" if finite(held_out_dph) is not None else f"not known ({reason or by})"
    return f"in-sample {number(rms_dph)}, held-out {outside} deg/h RMS, {floor_text(floor)}"


def text_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table, the first column to the left and the others to the right."""
    lines = [tuple(head), *map(tuple, rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return [
        "  ".join([line[0].ljust(widths[0]), *(text.rjust(w) for text, w in zip(line[1:], widths[1:], strict=True))])
        .rstrip()
        for line in lines
    ]  # fmt: skip


def html(title: str, caption: str, head: Sequence[str], rows: Sequence[Sequence[object]], *notes: str) -> str:
    """A sentence, a table (none without rows) and notes below it as HTML, all text escaped."""
    parts = [deliver.paragraph(title)]
    if rows:
        parts.append(deliver.table(caption, head, rows, numeric=range(1, len(head))))
    return "".join([*parts, *(deliver.paragraph(note) for note in notes if note)])


def figure(plot: Plot) -> go.Figure:
    """A figure of the reports as a plotly figure."""
    import plotly.graph_objects as go

    drawn = go.Figure(plot)
    drawn.update_layout(template="plotly_white")
    return drawn


def no_xarray() -> InputError:
    """What to do where xarray is missing."""
    return InputError("to_xarray needs xarray: pip install 'gyro-thermal-bench[notebook]'")
