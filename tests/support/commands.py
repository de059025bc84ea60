"""The command line, inside this process."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from click.testing import CliRunner, Result

from bench.cli import main


def bench(*words: object) -> Result:
    """The result of `bench` with these words; an exception that no command may let out comes through."""
    return CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)


@contextmanager
def undiagnosed() -> Iterator[None]:
    """Reports say nothing of effects that a model lacks, for tests that do not ask: to find them takes ten seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.analysis.judging.judge._diagnosed", lambda known, *_: known)
        yield
