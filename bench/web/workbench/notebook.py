"""`/notebooks`: an analysis of the workbench as a notebook that makes it again through `import bench`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from pydantic import Field

from bench.web.ground.settings import Here
from bench.web.workbench.asking import MOST_MODELS, ModelJson, RunChoice

router = APIRouter(tags=["workbench"])

_OPEN = """\
from pathlib import Path

import bench

archive = Path({archive})  # the folder of the runs
runs = [bench.open(archive / run{output}) for run in {runs}]
check = [bench.open(archive / run{output}) for run in {check}]  # no fit sees them
static = {static}  # tells the noise
sisters = [bench.open(archive / run{output}) for run in {sisters}]  # of units like it: how the noise drifts"""
_MODELS = """\
import tempfile

texts = {texts}
models = []
with tempfile.TemporaryDirectory() as folder:
    for text in texts:
        file = Path(folder) / "model.yaml"
        file.write_text(text, encoding="utf-8")
        models.append(bench.load_model(file))"""
_COMPARE = """\
comparison = bench.compare(runs, models, check=check, static=static)
print(comparison.summary())"""
_FIT = """\
fit = bench.fit(runs, models[-1], check=check, static=static)
print(fit.summary())
fit.plot()"""
_DIAGNOSE = """\
why = bench.diagnose(runs, models[-1], check=check, static=static, sisters=sisters)
print(why.summary())
why.plot()"""


class NotebookRequest(RunChoice):
    """Runs, and the models so far; the last one is the current one."""

    models: list[ModelJson] = Field(min_length=1, max_length=MOST_MODELS)


@router.post("/notebooks")
def notebook(request: Request, body: NotebookRequest, here: Here) -> dict[str, Any]:
    """The analysis as a notebook (nbformat 4): errors of the models, the fit and the diagnosis of the last one.

    Only a server without access file, which serves its own machine, says where its runs are.
    """
    body.resolved(request)
    archive = here.out.resolve() if request.app.state.access.open else Path("reports")
    texts = [model.model().to_yaml() for model in body.models]
    output = f", output={body.output!r}" if body.output else ""
    opened = f"bench.open(archive / {body.static!r}{output})" if body.static else "None"
    runs = {"runs": body.runs, "check": body.check, "sisters": body.sisters}
    begin = _OPEN.format(archive=repr(str(archive)), static=opened, output=output, **runs)
    title = f"# {', '.join(body.runs)}: {body.models[-1].name}"
    return _notebook([
        ("markdown", f"{title}\n\nMade from the workbench. It needs `pip install 'gyro-thermal-bench[notebook]'`."),
        ("code", begin),
        ("markdown", "## The models, in order"),
        ("code", _MODELS.format(texts=json.dumps(texts, ensure_ascii=False, indent=4))),
        ("code", _COMPARE),
        ("markdown", "## The last one"),
        ("code", _FIT),
        ("markdown", "## What it lacks"),
        ("code", _DIAGNOSE),
    ])  # fmt: skip


def _notebook(cells: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Cells (kind, source) as a notebook, https://nbformat.readthedocs.io/en/latest/format_description.html."""
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {
        "cells": [
            {
                "cell_type": kind,
                "id": f"cell-{number:02d}",
                "metadata": {},
                "source": source.splitlines(keepends=True),
                **({"execution_count": None, "outputs": []} if kind == "code" else {}),
            }
            for number, (kind, source) in enumerate(cells, 1)
        ],
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
