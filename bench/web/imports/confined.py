"""An uploaded file, read and imported by `bench.web.imports.parsing` in a confined process."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.acquisition import Confines, memory_for, run_confined

__all__ = ["Confines", "ask", "confined"]


def confined(do: str, wanted: Mapping[str, Any], folder: Path, confines: Confines | None = None) -> dict[str, Any]:
    """The result of `bench.web.imports.parsing`, which runs in `folder/file`, for a request about a file there.

    InputError, one line, where it refused the file or exceeded its limits.
    """
    confines, within = confines or Confines(), folder / "file"
    if confines.memory_bytes is None:
        size = (within / wanted["file"]).stat().st_size
        confines = replace(confines, memory_bytes=memory_for(size))
    return run_confined("bench.web.imports.parsing", {"do": do, **wanted}, folder, confines, within)


def ask(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`confined` as a job of the server (`bench.web.jobs.jobs`): the request holds `do` and `folder` too."""
    folder = Path(wanted["folder"])
    result = confined(str(wanted["do"]), {key: value for key, value in wanted.items() if key != "do"}, folder)
    if wanted["do"] == "make":
        shutil.rmtree(folder, ignore_errors=True)
    return result
