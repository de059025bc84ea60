"""A process that computes for the server: one line of JSON in, one line out; the server survives its end."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Mapping
from typing import IO, Any

_LOOK_S = 0.5
"""Interval of the checks whether a page still waits for a computation [s]."""
_PIECE = 1 << 20
KILLED = (
    "the computing process was ended, most likely for lack of memory: choose fewer runs or a simpler "
    "model, or try again"
)


class Refused(Exception):  # noqa: N818 - an answer, not an error of the worker
    """The computation was refused or failed; the text is one line."""


class GivenUp(Exception):  # noqa: N818 - an answer, not an error of the worker
    """No page waits for the computation."""


class Worker:
    """One computing process, which starts with the first request and again after it has ended."""

    def __init__(self) -> None:
        """The process starts with the first request."""
        self._child: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Id of the process; None without one."""
        return None if self._child is None else self._child.pid

    def compute(self, target: str, inputs: Mapping[str, Any], still_needed: Callable[[], bool]) -> bytes:
        """JSON of the result of `target` ('package.module:function').

        Raises Refused, or GivenUp once `still_needed` returns False, which ends the process.
        """
        request = json.dumps({"target": target, "inputs": inputs}).encode() + b"\n"
        try:
            answer = self._exchange(request, still_needed)
        except OSError:
            answer = b""
        if not answer:
            self.close()
            raise Refused(KILLED)
        if answer.startswith(b"!"):
            raise Refused(answer[1:].decode("utf-8", errors="replace"))
        return answer

    def warm(self) -> None:
        """Start the process, so that the first request does not wait for it."""
        self._started()

    def close(self) -> None:
        """End the process."""
        child, self._child = self._child, None
        if child is None:
            return
        child.kill()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):  # the process did not read its last request
                    pipe.close()
        child.wait()

    def _exchange(self, request: bytes, still_needed: Callable[[], bool]) -> bytes:
        child = self._started()
        assert child.stdin is not None
        assert child.stdout is not None
        child.stdin.write(request)
        child.stdin.flush()
        return self._answer(child.stdout, still_needed)

    def _answer(self, pipe: IO[bytes], still_needed: Callable[[], bool]) -> bytes:
        """One line without its line end; empty if the process ended."""
        pieces: list[bytes] = []
        while True:
            if not select.select([pipe], [], [], _LOOK_S)[0]:
                if not still_needed():
                    self.close()
                    raise GivenUp
                continue
            piece = os.read(pipe.fileno(), _PIECE)
            if not piece:
                return b""
            pieces.append(piece)
            if piece.endswith(b"\n"):
                return b"".join(pieces)[:-1]

    def _started(self) -> subprocess.Popen[bytes]:
        if self._child is not None and self._child.poll() is None:
            return self._child
        self.close()
        threads = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")} | {"MALLOC_ARENA_MAX": "2"}
        self._child = subprocess.Popen(
            [sys.executable, "-P", "-m", "bench.web.jobs.work"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, **threads}, start_new_session=True,
        )  # fmt: skip
        return self._child
