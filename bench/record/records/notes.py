"""Record notes.json of a run folder: what people wrote about the run, and views of it that they saved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, Self

from bench.record.records.stored import Record, Stored


class Note(Stored):
    """What somebody wrote."""

    text: str
    who: str
    utc: str


class View(Stored):
    """A state of the page's workbench under a name."""

    name: str
    address: str
    """What stands behind `/workbench`: runs, model, figure and its axes."""
    who: str
    utc: str


class NotesRecord(Record):
    """Notes in the order in which they were written, and views, one of a name."""

    FILE: ClassVar[str] = "notes.json"
    TITLE: ClassVar[str] = "notes"
    ADVICE: ClassVar[str] = "restore it from a backup; nothing else holds what people wrote"

    notes: tuple[Note, ...] = ()
    views: tuple[View, ...] = ()

    def noted(self, note: Note) -> Self:
        """With one more note."""
        return self.model_copy(update={"notes": (*self.notes, note)})

    def kept(self, view: View) -> Self:
        """With this view in the place of one of the same name."""
        return self.without(view.name).model_copy(update={"views": (*self.without(view.name).views, view)})

    def without(self, name: str) -> Self:
        """Without the view of this name."""
        return self.model_copy(update={"views": tuple(view for view in self.views if view.name != name)})

    @classmethod
    def change(cls, folder: Path, change: Callable[[Self], Self]) -> Self:
        """Change the record of a folder while nobody else does; the new one. InputError where it is damaged."""
        from bench.record.chain import extend  # which reads records

        made = cls()

        def changed(old: bytes) -> bytes:
            nonlocal made
            made = change(cls.parse(old, folder / cls.FILE) if old else cls())
            return made.text().encode()

        extend(folder, cls.FILE, changed)
        return made
