"""Section of the report about limits: the verdict, refusals, all results."""

from __future__ import annotations

from markupsafe import Markup

from bench.analysis import DECISION_RULE, Analysis, Result
from bench.base import finite, in_print, measured, number
from bench.deliver.report.markup import Row, Section, lead, paragraph, table
from bench.record import Verdict

_TONES = {Verdict.FAIL: "bad", Verdict.INVALID: "bad"}


def limits(analysis: Analysis) -> Section | None:
    """The verdict against limits; None without limits."""
    judged = analysis.judgement
    if judged is None:
        return None
    html = lead(f"{judged.verdict.value} against the limits “{judged.limits.name}”.")
    html += Markup().join(paragraph(f"Cannot be judged: {text}.") for text in judged.refusals)
    head = (
        "quantity",
        "value",
        "95 % interval",
        "lower",
        "upper",
        "marginal band",
        "unit",
        "verdict",
        "why this limit",
    )
    rows = [_row(result) for result in judged.results]
    html += table("All limits", head, rows, (1, 2, 3, 4, 5)) + paragraph(DECISION_RULE)
    return Section("limits", "Limits", html)


def _row(result: Result) -> Row:
    quantity, limit = result.quantity.to_json(), result.limit
    low, high = quantity["low"], quantity["high"]
    spread = "–" if low == high else f"{number(low)} to {number(high)}"
    word = result.verdict.value if result.verdict else "not measured"
    cells = (
        quantity["meaning"], measured(quantity["value"], high), spread, number(limit.lower), number(limit.upper),
        number(finite(limit.marginal)), in_print(result.quantity.unit), word, result.quantity.reason or limit.reason,
    )  # fmt: skip
    return Row(cells, _TONES.get(result.verdict, "") if result.verdict else "")
