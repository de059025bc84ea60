"""Reads a foreign file in a process with limits of memory, processor time, time and output."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.base import InputError

GIB = 2**30
ANSWER_BYTES = 4 * 2**20
_LAST_WORDS = 300


@dataclass(frozen=True)
class Confines:
    """Limits of a reading process; larger files need `bench import` on the command line."""

    memory_bytes: int = 6 * GIB
    cpu_s: int = 120
    wall_s: float = 240.0
    written_bytes: int = 4 * GIB


def confined(do: str, wanted: Mapping[str, Any], folder: Path, confines: Confines | None = None) -> dict[str, Any]:
    """The result of `bench.web.imports.parsing`, which runs in `folder/file`, for a request about a file there.

    InputError, one line, where it refused the file or exceeded its limits.
    """
    confines = confines or Confines()
    limits = asdict(confines)
    request, answer = folder / "request.json", folder / "answer.json"
    request.write_text(json.dumps({"do": do, **wanted, "confines": limits}), encoding="utf-8")
    answer.unlink(missing_ok=True)
    code, said = _run(
        [sys.executable, "-P", "-m", "bench.web.imports.parsing", str(request), str(answer)], folder, confines
    )
    if code == 0 and answer.is_file() and answer.stat().st_size <= ANSWER_BYTES:
        content = json.loads(answer.read_bytes())
        if "result" in content:
            result: dict[str, Any] = content["result"]
            return result
        refused = str(content["refused"])
        raise InputError(_too_much(confines) if refused == "memory" else refused)
    raise InputError(_in_words(code, said, confines))


def ask(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """`confined` as a job of the server (`bench.web.jobs.jobs`): the request holds `do` and `folder` too."""
    folder = Path(wanted["folder"])
    result = confined(str(wanted["do"]), {key: value for key, value in wanted.items() if key != "do"}, folder)
    if wanted["do"] == "make":
        shutil.rmtree(folder, ignore_errors=True)
    return result


def _run(command: list[str], folder: Path, confines: Confines) -> tuple[int | None, str]:
    """Exit code (None: killed after the time limit) and the end of stderr."""
    environment = {
        "PATH": os.defpath, "HOME": str(folder), "TMPDIR": str(folder), "LANG": "C.UTF-8", "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "2",
        "PYTHONFAULTHANDLER": "",
    }  # fmt: skip
    words = folder / "stderr.txt"
    with words.open("wb") as stderr:
        child = subprocess.Popen(
            command, cwd=folder / "file", env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=stderr, start_new_session=True,
        )  # fmt: skip
        try:
            code: int | None = child.wait(confines.wall_s)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)
                child.wait()
    return code, words.read_bytes()[-_LAST_WORDS:].decode("utf-8", errors="replace")


def _in_words(code: int | None, said: str, confines: Confines) -> str:
    if code in {None, -signal.SIGALRM}:
        return f"reading took longer than {confines.wall_s:g} s and was stopped; use `bench import` on the command line"
    if code in {-signal.SIGXCPU, -signal.SIGKILL}:
        return f"reading took more than {confines.cpu_s} s of processor time and was stopped: not an ordinary table"
    if code == -signal.SIGXFSZ:
        return f"the run would need more than {confines.written_bytes / GIB:.3g} GiB of disk: use `bench import`"
    if "MemoryError" in said or "bad_alloc" in said or code in {-signal.SIGABRT, -signal.SIGSEGV}:
        return _too_much(confines)
    return f"the reading process ended with code {code}: it cannot read this file"


def _too_much(confines: Confines) -> str:
    return (
        f"unpacked, the file needs more than the {confines.memory_bytes / GIB:.3g} GiB of memory that reading may use; "
        "use `bench import` on the command line"
    )
