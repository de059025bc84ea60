"""The computing process: reads requests, one JSON a line, answers each in one line, ends when its server is gone.

An answer that begins with `!` is the one line that says why there is none. It gives way to runs in every respect:
lower priority, first to be ended when memory is short, bounded in memory itself.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import sys
import traceback
from pathlib import Path
from typing import IO, Any

from bench.base import BenchError

_NICE = 10
_SHARE = 0.5
"""Of the machine's memory."""
_LEAST_BYTES = 2 << 30
_TOO_LARGE = "needs more memory than an analysis may use here: choose fewer runs or a simpler model"


def main() -> None:
    """Answer until the server closes the pipe."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not pass for an answer
    give_way()
    # What every request needs is loaded while nobody waits yet.
    importlib.import_module("bench.web.workbench.computing")
    serve(sys.stdin.buffer, answers)


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """One answer for each line."""
    for line in requests:
        request = json.loads(line)
        answers.write(_answer(str(request["target"]), request["wanted"]) + b"\n")
        answers.flush()


def _answer(target: str, wanted: dict[str, Any]) -> bytes:
    try:
        module, _, name = target.partition(":")
        result = getattr(importlib.import_module(module), name)(wanted)
        return json.dumps(result, allow_nan=False).encode()
    except BenchError as error:
        return _refusal(str(error))
    except MemoryError:
        return _refusal(_TOO_LARGE)
    except Exception as error:  # numerics on data that nobody foresaw: the next request is served all the same
        traceback.print_exc()
        return _refusal(f"the computation failed ({type(error).__name__}: {error})")


def _refusal(text: str) -> bytes:
    return b"!" + "; ".join(line.strip() for line in text.splitlines() if line.strip()).encode()


def give_way() -> None:
    """Let runs go first: processor, memory."""
    os.nice(_NICE)
    with contextlib.suppress(OSError):  # Linux only
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    most = max(int(_SHARE * memory), _LEAST_BYTES)
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


if __name__ == "__main__":
    main()
