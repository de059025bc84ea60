"""The errors of the bench: one class for each decision that a caller can take.

BenchError                  anything the bench refuses or cannot do; its text is one line for the user
├── InputError              the user's file, value or command is wrong                  exit 2
│   ├── NotResumableError   a run has nothing that can be gone on with: repeat it
│   └── LeftRunError        this unit's part ended before the run did: it needs one of its own
├── RunAborted              operator or guard ended the run, safe state reached         exit 3
├── EquipmentError          equipment failed, safe state reached or loudly not          exit 4
└── CentreError             the centre is not reached, refuses, or lacks a file          exit 4
"""

from __future__ import annotations

from pathlib import Path


class BenchError(Exception):
    """Base of all errors that the command line turns into one line and an exit code."""

    exit_code = 2


class InputError(BenchError):
    """Bad input: says what, where, the value, what is allowed and what to do."""

    exit_code = 2

    def __init__(self, text: str, file: str | Path | None = None, line: int | None = None) -> None:
        where = "" if file is None else f"{file}:{line}: " if line is not None else f"{file}: "
        super().__init__(f"{where}{text}")
        self.file = file
        self.line = line


class NotResumableError(InputError):
    """A run went to its end, or was killed before it recorded anything that can be gone on with."""


class LeftRunError(InputError):
    """A run went on without this unit, so that its part cannot be resumed alone."""


class RunAborted(BenchError):  # noqa: N818 - an abort is an outcome, not an error of the bench
    """The operator or a guard ended the run; the safe state was reached and read back."""

    exit_code = 3


class EquipmentError(BenchError):
    """Equipment failed; the text says whether the safe state was verified."""

    exit_code = 4


class CentreError(BenchError):
    """The centre cannot be reached, refuses, or has lost or damaged a file; what is on this computer is unharmed."""

    exit_code = 4
