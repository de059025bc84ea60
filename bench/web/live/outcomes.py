"""What became of a run or a calibration that the page started: from the files that its process left."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from bench.record import MANIFEST, StartRecord
from bench.web.ground.problems import within
from bench.web.live.story import state_of

EXIT = "exit_code"
"""The exit code of the process, in the folder of its start."""
LOCK = "lock"
"""The process holds it while it lives."""
_SAID_BYTES = 1 << 20


def outcome(folder: Path, about: StartRecord, alive: bool, out: Path, project: Path) -> dict[str, Any]:
    """State, exit code, verdict and message of a start; paths are those from the project and from `out`."""
    nothing: dict[str, Any] = {"exit_code": None, "verdict": None, "sentence": "", "message": "", "verdicts": []}
    if waits(folder, about):
        return {**nothing, "state": "waiting"}
    if alive:
        return {**nothing, "state": "running" if about.runs else "starting"}
    code = _exit_code(folder)
    said = within(project, _said(folder), out)
    content = _answer(folder)
    runs = _runs(content, out) or list(about.runs)
    if code is None:
        again = _again(about, runs[0], out) if runs else "start it again"
        return {**nothing, "state": "ended", "runs": runs, "message": f"something ended its process; {again}"}
    if code == 2 and not runs:
        return {**nothing, "state": "refused", "exit_code": code, "message": said}
    return {
        "state": "ended",
        "runs": runs,
        "exit_code": code,
        "verdict": content.get("verdict"),
        "sentence": within(project, str(content.get("sentence", "")), out),
        "message": within(project, str(content.get("error", "")), out) or ("" if content else said),
        "verdicts": [state_of(unit) for unit in content.get("units", [content] if content else [])],
    }


def waits(folder: Path, about: StartRecord) -> bool:
    """Whether a start waits for its equipment: it has no process yet."""
    return bool(about.waiting) and not (folder / LOCK).exists()


def _again(about: StartRecord, run: str, out: Path) -> str:
    """Advice for a run whose process was killed, during the run or its analysis."""
    if about.digest:
        return "its calibration can go on"
    if (out / run / MANIFEST).is_file():
        return f"`bench report {run}` analyses it"
    return f"`bench resume {run}` goes on with it"


def _exit_code(folder: Path) -> int | None:
    try:
        return int((folder / EXIT).read_text())
    except (OSError, ValueError):
        return None


def _said(folder: Path) -> str:
    """Last message of `bench`, as one line."""
    with contextlib.suppress(OSError):
        lines = (folder / "stderr").read_bytes()[-_SAID_BYTES:].decode("utf-8", "replace").splitlines()
        first = next((i for i, line in enumerate(lines) if line.startswith("bench: ")), max(len(lines) - 1, 0))
        return "; ".join(line.removeprefix("bench: ").strip() for line in lines[first:] if line.strip())[:2000]
    return ""


def _answer(folder: Path) -> dict[str, Any]:
    """The object that `bench run --json` printed; empty without one."""
    try:
        content = json.loads((folder / "stdout").read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _runs(content: Mapping[str, Any], out: Path) -> list[str]:
    """Ids of the runs in an answer."""
    return list(_ids((unit.get("run") for unit in content.get("units", [content])), out))


def _ids(paths: Iterable[str | None], out: Path) -> Iterator[str]:
    for path in paths:
        if path:
            with contextlib.suppress(ValueError):
                yield Path(path).resolve().relative_to(out).as_posix()
