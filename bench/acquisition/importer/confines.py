"""Reads files of others in a process with limits of memory, processor time, time and output.

The limit of memory follows the size of the file and what is free: a run that is live here keeps its share.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.base import BenchError, InputError
from drivers.system import end_group

GIB = 2**30
ANSWER_BYTES = 4 * 2**20
LEAST_BYTES = 10**9
"""Memory that the reading of any file may take, its programs included, if there is so much."""
FOR_EACH_BYTE = 32
"""Memory for each byte of a large file: a measured value takes a byte or more in any file, and 8 in a table, thrice."""
FOR_A_RUN = 1 * GIB
"""Free memory that is left for a run that is live, or about to be."""
_POOR = 4 * 10**8
"""Less than this, nothing can be read at all."""
_START_S, _EACH_MB_S = 8, 20
"""Processor time for any file and for each megabyte of it; a table of text takes about 0.1 s a megabyte."""
_UNKNOWN = 4 * GIB
_LAST_WORDS = 300
_LACKS = ("bad_alloc", "Memory", "malloc", "allocate", "failed to map segment")
"""Words of errors for want of memory; the last are the loader's, of a library that is imported then."""
_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of prctl(2)."""
_LONGEST = 600
"""Characters of a message, which may hold names of columns."""


@dataclass(frozen=True)
class Confines:
    """Limits of a reading process; the memory is that of `memory_for` unless it is given."""

    memory_bytes: int | None = None
    cpu_s: int = 120
    wall_s: float = 240.0
    written_bytes: int = 4 * GIB


def free_bytes() -> int:
    """Memory that is free on this computer, or in the container that this process is in."""
    found = [_UNKNOWN]
    try:
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        found = [int(row.split()[1]) * 1024 for row in text.splitlines() if row.startswith("MemAvailable:")] or found
    except OSError:  # not Linux
        return _UNKNOWN
    for limit, used in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        try:
            root = Path("/sys/fs/cgroup")
            found.append(int((root / limit).read_text()) - int((root / used).read_text()))
        except (OSError, ValueError):  # no such group, or "max"
            continue
    return max(min(found), 0)


def memory_for(file_bytes: int) -> int:
    """Memory that the reading of a file of this size may take."""
    share = max((free_bytes() - FOR_A_RUN) // 2, _POOR)
    return min(share, max(LEAST_BYTES, FOR_EACH_BYTE * file_bytes))


def processor_s_for(file_bytes: int) -> int:
    """Processor time that the reading of a file of this size may take: a parser can run in circles in a damaged one."""
    return min(_START_S + _EACH_MB_S * (file_bytes >> 20), 4 * 3600)


def run_confined(
    module: str, wanted: Mapping[str, Any], folder: Path, confines: Confines, within: Path | None = None
) -> dict[str, Any]:
    """The result of `module`, whose `main` is `answering`, for a request; its files are in `folder`.

    It runs in `within` (default: where this process is). InputError, one line, where it refused the file or exceeded
    its limits.
    """
    request, answer = folder / "request.json", folder / "answer.json"
    request.write_text(json.dumps({**wanted, "confines": asdict(confines)}), encoding="utf-8")
    answer.unlink(missing_ok=True)
    code, said = _run([sys.executable, "-P", "-m", module, str(request), str(answer)], folder, within, confines)
    if code == 0 and answer.is_file() and answer.stat().st_size <= ANSWER_BYTES:
        content = json.loads(answer.read_bytes())
        if "result" in content:
            result: dict[str, Any] = content["result"]
            return result
        refused = str(content["refused"])
        raise InputError(_too_much(confines) if refused == "memory" else refused)
    raise InputError(_in_words(code, said, confines))


def answering(do: Callable[[Mapping[str, Any]], dict[str, Any]], request: Path, answer: Path) -> None:
    """The `main` of a confined module: what `do` says of the request becomes the answer, a file of limited size."""
    wanted = json.loads(request.read_text(encoding="utf-8"))
    confine(wanted["confines"])
    try:
        content: dict[str, Any] = {"result": do(wanted)}
    except BenchError as error:
        content = {"refused": shortened(str(error))}
    except MemoryError:
        content = {"refused": "memory"}
    except Exception as error:  # a parser failed at an unforeseen file: its message without a traceback
        lack = any(word in f"{type(error).__name__} {error}" for word in _LACKS)
        content = {"refused": "memory" if lack else shortened(f"cannot be read ({type(error).__name__}: {error})")}
    answer.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
    os._exit(0)  # at once: what libraries of readers do at the end, with threads of their own, may fail


def confine(limits: Mapping[str, float]) -> None:
    """Set limits that this process cannot lift; it ends with its parent, or at the alarm."""
    import ctypes

    try:
        import resource
    except ImportError:  # Windows: who waits for this process ends it in time
        return
    with contextlib.suppress(OSError, AttributeError):  # not Linux: the alarm remains
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    signal.setitimer(signal.ITIMER_REAL, limits["wall_s"] + 1.0)
    for name, kind in (("memory_bytes", resource.RLIMIT_AS), ("cpu_s", resource.RLIMIT_CPU),
                       ("written_bytes", resource.RLIMIT_FSIZE)):  # fmt: skip
        own = resource.getrlimit(kind)[1]
        most = int(limits[name]) if own == resource.RLIM_INFINITY else min(int(limits[name]), own)
        resource.setrlimit(kind, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128))


def shortened(text: str) -> str:
    """One line of bounded length without control characters."""
    line = " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 1]}…"


def _run(command: list[str], folder: Path, within: Path | None, confines: Confines) -> tuple[int | None, str]:
    """Exit code (None: killed after the time limit) and the end of stderr.

    It imports from where this process does, which another installed version of the bench must not replace.
    """
    environment = {
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if Path(path).is_absolute()),
        "PATH": os.defpath, "HOME": str(folder), "TMPDIR": str(folder), "LANG": "C.UTF-8", "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "2",
        "PYTHONFAULTHANDLER": "",
    }  # fmt: skip
    words = folder / "stderr.txt"
    with words.open("wb") as stderr:
        child = subprocess.Popen(
            command, cwd=within, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=stderr, start_new_session=True,
        )  # fmt: skip
        try:
            code: int | None = child.wait(confines.wall_s)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            if child.poll() is None:
                end_group(child)
                child.wait()
    return code, words.read_bytes()[-_LAST_WORDS:].decode("utf-8", errors="replace")


def _in_words(code: int | None, said: str, confines: Confines) -> str:
    name = "" if code is None or code >= 0 else _signal(-code)
    if code is None or name == "SIGALRM":
        return f"reading took longer than {confines.wall_s:g} s and was stopped; use `bench import` on the command line"
    if name in {"SIGXCPU", "SIGKILL"}:
        return f"reading took more than {confines.cpu_s} s of processor time and was stopped: not an ordinary table"
    if name == "SIGXFSZ":
        return f"the run would need more than {confines.written_bytes / GIB:.3g} GiB of disk: use `bench import`"
    if "MemoryError" in said or "bad_alloc" in said or name in {"SIGABRT", "SIGSEGV"}:
        return _too_much(confines)
    return f"the reading process ended with code {code}: it cannot read this file"


def _signal(number: int) -> str:
    return next((found.name for found in signal.Signals if found == number), "")


def _too_much(confines: Confines) -> str:
    most = (confines.memory_bytes or 0) / 1e9
    return (
        f"unpacked, the file needs more than the {most:.3g} GB of memory that reading it may use; export it again with "
        "the columns that are needed only, or at a lower rate, or allow more: `bench import --memory GB`"
    )
