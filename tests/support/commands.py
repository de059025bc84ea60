"""The command line, inside this process."""

from click.testing import CliRunner, Result

from bench.cli import main


def bench(*words: object) -> Result:
    """The result of `bench` with these words; an exception that no command may let out comes through."""
    return CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)
