"""The computing process: reads one JSON request per line, answers each in one line, ends with its server.

An answer that begins with `!` is an error message. Runs have precedence: this process has a lower priority, a limit of
memory, and is the first one that Linux ends when memory is short.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import sys
import traceback
from pathlib import Path
from typing import IO, Any

from bench.base import BenchError

_NICE = 10
_SHARE = 0.5
"""Share of the computer's memory that a computation may use."""
_LEAST_BYTES = 2 << 30
_FIRST_MODULES = (
    "bench.web.workbench.diagnosing", "bench.web.workbench.drawing", "cryptography.hazmat.primitives.serialization",
    "pyarrow.compute", "scipy.interpolate", "scipy.optimize",
)  # fmt: skip
_TOO_LARGE = "the analysis needs more memory than it may use here: choose fewer runs or a simpler model"


def main() -> None:
    """Answer until the server closes the pipe."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the output of a library must not be taken for an answer
    lower_priority()
    load()
    serve(sys.stdin.buffer, answers)


def load() -> None:
    """Load what the first requests need, before one arrives: a person waits for it."""
    for name in _FIRST_MODULES:
        importlib.import_module(name)
    import numpy as np
    import plotly.graph_objects as go

    from bench.deliver import axis, plot

    plot([go.Scatter(y=np.zeros(1))], {"xaxis": axis("")})  # plotly loads many modules with the first curve


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """One answer for each line."""
    for line in requests:
        request = json.loads(line)
        answers.write(_answer(str(request["target"]), request["inputs"]) + b"\n")
        answers.flush()


def _answer(target: str, inputs: dict[str, Any]) -> bytes:
    try:
        module, _, name = target.partition(":")
        result = getattr(importlib.import_module(module), name)(inputs)
        return json.dumps(result, allow_nan=False).encode()
    except BenchError as error:
        return _refusal(str(error))
    except MemoryError:
        return _refusal(_TOO_LARGE)
    except Exception as error:  # unforeseen data: the process must continue with the next request
        traceback.print_exc()
        return _refusal(f"the computation failed ({type(error).__name__}: {error})")


def _refusal(text: str) -> bytes:
    return b"!" + "; ".join(line.strip() for line in text.splitlines() if line.strip()).encode()


def lower_priority() -> None:
    """Give runs precedence in processor time and memory."""
    try:
        import resource
    except ImportError:  # Windows has neither priorities nor limits of this kind
        return
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
