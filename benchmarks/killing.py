"""A command in a copy of this process, killed at a change of a file or at a moment."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate"}
_SAID = 300

Words = Sequence[object]
"""Arguments of `bench`; or a function, which is called with the rest."""


@dataclass(frozen=True)
class Done:
    """How it ended."""

    code: int | None
    """Exit code; None: killed."""
    changes: int
    """Changes of files below its folder (opening for writing, renaming, removing, making a folder)."""
    took_s: float
    said: str
    """Its last words."""


def in_a_copy(
    words: Words, root: Path, kill_at: int | None = None, when: Callable[[float], bool] | None = None
) -> Done:
    """Run a command with the working folder `root`.

    It is killed with its process group just before its change number `kill_at` below `root`, or as soon as `when`
    (called with the seconds since its start) says so.
    """
    counter, said, imported = root / ".changes", root / ".said", root / ".imported"
    began_s = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.setsid()
        _child(words, root, kill_at, counter, said, imported)
    while when is not None and os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if when(time.monotonic() - began_s):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
            break
        time.sleep(0.002)
    _, status = os.waitpid(pid, 0)
    took_s = time.monotonic() - began_s
    with contextlib.suppress(ProcessLookupError):  # what it started in its group ends with it
        os.killpg(pid, signal.SIGKILL)
    code = None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)
    changes = counter.stat().st_size if counter.exists() else 0
    text = said.read_text(encoding="utf-8", errors="replace") if said.exists() else ""
    if imported.exists():
        also_import(imported.read_text(encoding="utf-8").split())
    for file in (counter, said, imported):
        file.unlink(missing_ok=True)
    return Done(code, changes, took_s, text[-_SAID:])


def also_import(names: Sequence[str]) -> None:
    """Import here what a copy of this process imported, so that the next copy need not."""
    for name in names:
        if name not in sys.modules:
            with contextlib.suppress(Exception):  # names that a module gave to itself
                importlib.import_module(name)


def _child(words: Words, root: Path, kill_at: int | None, counter: Path, said: Path, imported: Path) -> NoReturn:
    out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(out, stream)
    marks = os.open(counter, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    names = os.open(imported, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    inside = f"{root}{os.sep}"
    done = 0

    def watch(event: str, facts: tuple[object, ...]) -> None:
        nonlocal done
        if event == "open":
            path, mode, flags = facts[0], facts[1], facts[2]
            changes = isinstance(flags, int) and bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
            changes = changes or (isinstance(mode, str) and any(letter in mode for letter in "wax+"))
        else:
            path, changes = facts[0] if facts else None, event in _CHANGES or event == "sqlite3.connect"
        if not changes or not isinstance(path, str | os.PathLike) or not os.fspath(path).startswith(inside):
            return
        done += 1
        os.write(marks, b".")
        if done == kill_at:
            os.killpg(0, signal.SIGKILL)

    os.chdir(root)
    sys.addaudithook(watch)
    code = 70
    try:
        if callable(words[0]):
            code = int(words[0](*words[1:]))
        else:
            from bench.cli import main

            main([str(word) for word in words], standalone_mode=True)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException as error:
        print(f"Traceback: {type(error).__name__}: {error}", file=sys.stderr)
    finally:
        sys.stderr.flush()
        os.write(names, "\n".join(sorted(sys.modules)).encode())
        os._exit(code)
