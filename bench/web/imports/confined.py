"""An uploaded file, shown and imported; what parses it runs in a confined process."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.acquisition import Confines, memory_for, read_confined, run_confined
from bench.web.imports.parsing import make

__all__ = ["Confines", "ask", "previewed"]


def previewed(wanted: Mapping[str, Any], folder: Path, confines: Confines | None = None) -> dict[str, Any]:
    """The result of `bench.web.imports.parsing`, which runs in `folder/file`, for a request about a file there.

    InputError, one line, where it refused the file or exceeded its limits.
    """
    confines, within = confines or Confines(), folder / "file"
    if confines.memory_bytes is None:
        size = (within / wanted["file"]).stat().st_size
        confines = replace(confines, memory_bytes=memory_for(size))
    return run_confined("bench.web.imports.parsing", wanted, folder, confines, within)


def ask(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Show or make it (`do`), as a job of the server (`bench.web.jobs.jobs`), in the request's `folder`."""
    folder = Path(wanted["folder"])
    if wanted["do"] == "preview":
        return previewed(wanted, folder)
    with contextlib.chdir(folder / "file"):  # messages and records name the file without the server's folders
        encoding = (wanted.get("columns") or {}).get("encoding")
        table = read_confined(Path(wanted["file"]), wanted["dbc"] and Path(wanted["dbc"]), encoding=encoding)
        result = make(wanted, table)
    shutil.rmtree(folder, ignore_errors=True)
    return result
