"""A process that computes for the server: one line of JSON in, one line out; its death harms nothing."""

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
    "something ended the computing process, most likely a lack of memory: choose fewer runs or a simpler "
    "model, or ask again"
)


class Refused(Exception):  # noqa: N818 - an answer, not an error of the worker
    """The computation was refused or failed; the text is one line."""


class GivenUp(Exception):  # noqa: N818 - an answer, not an error of the worker
    """No page waits for the computation any more."""


class Worker:
    """One computing process, which starts with the first request and again after it died."""

    def __init__(self) -> None:
        """Does not start the process."""
        self._child: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Id of the process; None without one."""
        return None if self._child is None else self._child.pid

    def compute(self, target: str, wanted: Mapping[str, Any], wanted_still: Callable[[], bool]) -> bytes:
        """JSON of the result of `target` ('package.module:function').

        Raises Refused, or GivenUp once `wanted_still` returns False, which ends the process.
        """
        request = json.dumps({"target": target, "wanted": wanted}).encode() + b"\n"
        try:
            answer = self._exchange(request, wanted_still)
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

    def _exchange(self, request: bytes, wanted_still: Callable[[], bool]) -> bytes:
        child = self._started()
        assert child.stdin is not None
        assert child.stdout is not None
        child.stdin.write(request)
        child.stdin.flush()
        return self._answer(child.stdout, wanted_still)

    def _answer(self, pipe: IO[bytes], wanted_still: Callable[[], bool]) -> bytes:
        """One line without its end; empty where the process died."""
        pieces: list[bytes] = []
        while True:
            if not select.select([pipe], [], [], _LOOK_S)[0]:
                if not wanted_still():
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
