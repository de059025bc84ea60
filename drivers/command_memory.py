"""Calibration memory behind a command of the user: any protocol, served by a program that the station file names.

One command writes: it gets the image, and its output is what it read back. One reads: its output is the image in force,
nothing where there is none. An optional one switches the unit's correction on and off. A command is a list of
arguments and is started without a shell.
"""

from __future__ import annotations

import os
import re
import shlex
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import ConfigError, DriverError, IdentityError, LimitError, LinkError, ReadBackError, RefusedError
from drivers.program import Program
from drivers.unit_memory import LEAST_BYTES, Held, Onlooker, Programmed, UnitMemory, compare, named, serial_of

PLACES: Mapping[str, tuple[str, ...]] = {
    "write": ("image", "serial", "number"),
    "read": ("serial", "number"),
    "compensate": ("state", "serial", "number"),
}
"""What each command may name in braces; `state` is on or off."""
MOST_BYTES = 1_000_000
"""Longest output of a command that is taken for an image."""


@dataclass(frozen=True)
class Commands:
    """The commands of a unit; `folder` is where they are started, `names` fill the places in braces."""

    write: Sequence[str]
    read: Sequence[str]
    compensate: Sequence[str]
    timeout_s: float
    folder: Path
    names: Mapping[str, str]
    identity: int | None
    """Serial number that images must have; None: not checked."""


def wrong_place(which: str, words: Sequence[str]) -> str | None:
    """What is wrong with the places in braces of a command; None: nothing."""
    for place in re.findall(r"\{(\w+)\}", " ".join(words)):
        if place not in PLACES[which]:
            known = ", ".join(f"{{{name}}}" for name in PLACES[which])
            return f"{{{place}}} is not known here; allowed: {known}"
    if which == "compensate" and words and not any("{state}" in word for word in words):
        return "one argument must be {state}, for which `on` or `off` is put in"
    return None


class CommandMemory(UnitMemory):
    """The memory of the unit that is called `who` in errors."""

    def __init__(self, commands: Commands, who: str) -> None:
        self._commands, self._who = commands, who

    def held(self) -> Held:
        """The image that `read` prints."""
        return Held(self._run(self._commands.read))

    def compensate(self, on: bool) -> None:
        """ConfigError where no command does it."""
        if not self._commands.compensate:
            raise ConfigError("its `flash` has no command `compensate`")
        self._run(self._commands.compensate, state="on" if on else "off")

    def program(
        self, image: bytes, archive: Callable[[bytes], None] = lambda old: None, onlooker: Onlooker = lambda step: None
    ) -> Programmed:
        """See UnitMemory; what the unit holds is read by `read` once more after `write`."""
        if len(image) % 4 or not LEAST_BYTES <= len(image) <= MOST_BYTES:
            raise LimitError(f"image of {len(image)} bytes, it has whole words, {LEAST_BYTES} to {MOST_BYTES} bytes")
        done, known = Programmed(serial_of(image)), self._commands.identity
        left = "nothing was written"
        if known is not None and done.serial != known:
            text = f"the image is for serial number {done.serial}, in the station file the unit is {known}"
            raise IdentityError(f"{self._who}: {text}; {left}")
        with _step("archive", left, done, onlooker):
            done.old = self.held().image
            archive(done.old)
        left = "what the unit holds is not known: flash again"
        with _step("write", left, done, onlooker), tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "image.bin"
            file.write_bytes(image)
            compare(image, self._run(self._commands.write, file))
        with _step("read again", left, done, onlooker):
            compare(image, self.held().image)
        return done

    def _run(self, words: Sequence[str], image: Path | None = None, **more: str) -> bytes:
        """Output of a command. The image is its standard input, unless an argument names `{image}`."""
        commands = self._commands
        names = {**commands.names, **more, **({} if image is None else {"image": str(image)})}
        argv = [re.sub(r"\{(\w+)\}", lambda place: names[place[1]], word) for word in words]
        what = f"{self._who}: command {shlex.join(argv)}"
        given = os.devnull if image is None or any("{image}" in word for word in words) else image
        with Path(given).open("rb") as source, tempfile.TemporaryFile() as output:
            try:
                program = Program(argv, commands.folder, commands.timeout_s, source, output)
            except ConfigError as error:
                raise ConfigError(f"{what} {error}") from None
            with closing(program):
                program.wait()
            if program.code is None:
                raise LinkError(f"{what} did not end within {commands.timeout_s:g} s")
            if program.code:
                how = "ended with exit code" if program.code > 0 else "was ended by signal"
                said = f": {program.last_line}" if program.last_line else ", without a word on its standard error"
                raise RefusedError(f"{what} {how} {abs(program.code)}{said}", program.code)
            output.seek(0)
            told = output.read(MOST_BYTES + 1)
        if len(told) > MOST_BYTES:
            raise ReadBackError(f"{what} printed more than {MOST_BYTES} bytes, which is no image")
        return told


@contextmanager
def _step(name: str, left: str, done: Programmed, onlooker: Onlooker) -> Iterator[None]:
    """Errors that name the step and the resulting state of the unit."""
    onlooker(name)
    started_s = time.monotonic()
    try:
        yield
    except DriverError as error:
        raise named(error, f"step '{name}' failed: {error}; {left}") from error
    finally:
        done.took_s[name] = round(time.monotonic() - started_s, 3)
