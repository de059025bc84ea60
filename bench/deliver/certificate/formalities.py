"""What a certificate must name and only a person can write down (ISO/IEC 17025, 7.8.2.1; ILAC P10 for traceability)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.base import Document, InputError
from bench.deliver.certificate.laboratory import load_instruments, load_laboratory

FILES = "give a file with {content} with --{kind}, or name it in the station file (`{kind}:`)"
"""How papers that are missing are given to a command."""
_SIGNATORY = "`authorised_by: {name: A. Example, function: head of laboratory}`"


@dataclass(frozen=True)
class Lack:
    """One thing that is missing, what to write, and where."""

    what: str
    """Short, as it stands across a draft."""
    todo: str
    file: str
    line: int | None = None

    def error(self, without: str = "a draft can be printed without it (--draft)") -> InputError:
        """The refusal, one line; `without`: what is left to whoever cannot add it."""
        return InputError(f"no certificate: {self.what}; {self.todo}; {without}", self.file, self.line)


def lacking(
    laboratory: Document | None,
    equipment: Document | None,
    run: Path,
    give: str = FILES,
) -> tuple[Lack, ...]:
    """Everything that is missing, in the order of the certificate; InputError where a file is wrong.

    `give`: how a file that is missing is given, with its `content` and `kind`.
    """
    found = [
        *_laboratory(laboratory, run, give),
        *_equipment(equipment, run, give),
    ]
    return tuple(_unsealed(lack, run) for lack in found)


def _laboratory(document: Document | None, run: Path, give: str) -> Iterator[Lack]:
    if document is None:
        content = f"`laboratory: {{name: …, address: …}}` and {_SIGNATORY}"
        todo = give.format(content=content, kind="laboratory")
        yield Lack("no laboratory and no signatory", todo, str(run))
        return
    known = load_laboratory(document)
    if not known.laboratory.name.strip():
        yield Lack("no laboratory", "fill in its name", document.file, document.line(("laboratory", "name")))
    if known.authorised_by is None:
        yield Lack("no signatory", f"add {_SIGNATORY}", document.file, _end(document))
    elif not known.authorised_by.name.strip():
        yield Lack("no signatory", "fill in the name", document.file, document.line(("authorised_by", "name")))


def _equipment(document: Document | None, run: Path, give: str) -> Iterator[Lack]:
    if document is None:
        todo = give.format(content="every instrument that the results are traced to", kind="equipment")
        yield Lack("no equipment", todo, str(run))
        return
    for i, tool in enumerate(load_instruments(document)):
        if tool.due is None:
            todo = "add `due: YYYY-MM-DD`, the last day on which its calibration is valid"
            line = document.line(("equipment", i))
            yield Lack(f"no due date of {tool.name} {tool.serial}", todo, document.file, line)


def _end(document: Document) -> int:
    """The line after the last one."""
    return document.text.rstrip().count("\n") + 2


def _unsealed(lack: Lack, run: Path) -> Lack:
    """The same; a copy in a run folder is sealed and must not be changed there."""
    file = Path(lack.file)
    if file.parent != run or file == run:
        return lack
    option = f"--{file.stem}"
    todo = f"{lack.todo} in the file of the station; this copy is sealed, so give that file with {option}"
    return Lack(lack.what, todo, lack.file, lack.line)
