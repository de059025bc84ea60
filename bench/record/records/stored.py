"""What all records share: how one is read from the disk and written to it, and what damage means."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from bench.base import InputError
from bench.record.files import write_atomically

_SHOWN = 60
"""So many characters of a wrong value are shown."""


def _content(path: str) -> bytes | None:
    """The bytes of a file, None where there is none; InputError where it cannot be read."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 - a Path costs more than the reading of a short file
            return file.read()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path) from None


class Stored(BaseModel):
    """A part of a record; keys that it does not know are kept."""

    model_config = ConfigDict(
        extra="allow", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True, defer_build=True
    )

    def content(self) -> dict[str, Any]:
        """As it stands in the file: plain values, without what nobody said."""
        return self.model_dump(mode="json", exclude_unset=True, by_alias=True)


class Record(Stored):
    """A JSON file that the bench writes and reads again.

    The newest format that a class reads, and the one that it writes, is the default of its `format`.
    """

    FILE: ClassVar[str]
    """Name of the file in its folder, or a pattern of names."""
    TITLE: ClassVar[str]
    """Name of the record's JSON Schema."""
    ADVICE: ClassVar[str] = "make it again with `bench report`"
    """What to do where the file is missing or damaged."""
    MISSING: ClassVar[str] = ""
    """Said of a missing file in place of the usual words."""
    CHAINED: ClassVar[bool] = True
    """Whether the folder's chain lists it."""
    ROOT: ClassVar[bool] = False
    """Whether it says of which unit and run its folder is."""
    MADE_FROM: ClassVar[tuple[str, ...]] = ()
    """Files of its folder that it is made from."""

    format: int = 1
    """Version of this kind of file; absent in files older than the number."""

    @classmethod
    def read(cls, folder: Path, name: str | None = None) -> Self:
        """The record in a folder, or of another name there; InputError where it is missing or damaged."""
        record = cls.find(folder, name)
        if record is not None:
            return record
        if not folder.is_dir():
            raise InputError("no such run folder", folder)
        raise InputError(cls.MISSING or f"{name or cls.FILE} is missing; {cls.ADVICE}", folder)

    @classmethod
    def find(cls, folder: Path | str, name: str | None = None) -> Self | None:
        """The record in a folder, None where there is none; InputError where it is damaged.

        Every record comes from the disk here and nowhere else.
        """
        path = f"{folder}/{name or cls.FILE}"
        data = _content(path)
        record = None if data is None else cls.parse(data, path)
        if cls.CHAINED:
            try:
                _chain().check(folder, name or cls.FILE, data, cls.ADVICE)
            except InputError:
                if _content(path) == data:
                    raise
                return cls.find(folder, name)  # it was replaced between the two readings
        return record

    @classmethod
    def parse(cls, data: bytes, path: Path | str) -> Self:
        """The record in the bytes of a file; InputError, which names `path`, where it is damaged."""
        newest, record = cls._newest(), None
        with contextlib.suppress(ValidationError):
            record = cls.model_validate_json(data, strict=True)
        if record is not None and "format" in record.model_fields_set and record.format == newest:
            return record
        try:
            content = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise InputError(f"is not valid JSON ({error}); {cls.ADVICE}", path) from None
        if not isinstance(content, dict):
            raise InputError(f"is not a JSON object; {cls.ADVICE}", path)
        found = content.get("format", 0)
        if isinstance(found, int) and found > newest:
            raise InputError(
                f"is of format {found}, this bench reads up to {newest}: use the bench that wrote it", path
            )
        if isinstance(found, int) and found < newest:
            migrated = cls._migrated(content, found)
            if record is not None and migrated is content:
                return record
            content = {**migrated, "format": newest}
        try:
            return cls.model_validate_json(json.dumps(content), strict=True)
        except ValidationError as error:
            raise InputError(f"{_wrong(error)}; {cls.ADVICE}", path) from None

    @classmethod
    def _newest(cls) -> int:
        return int(cls.model_fields["format"].default)

    @classmethod
    def _migrated(cls, content: dict[str, Any], found: int) -> dict[str, Any]:
        """The content of a file of the older format `found` (0: without a number) in the words of the newest.

        The same object where nothing has to change.
        """
        return content

    def content(self) -> dict[str, Any]:
        """As it stands in the file: the format first, plain values, without what nobody said."""
        return {
            "format": self._newest(),
            **self.model_dump(mode="json", exclude_unset=True, by_alias=True, exclude={"format"}),
        }

    def text(self) -> str:
        """The text of the file; ValueError where a number is not finite."""
        return json.dumps(self.content(), indent=1, allow_nan=False) + "\n"

    def write(self, folder: Path, name: str | None = None, others: Mapping[str, str] | None = None) -> Path:
        """Replace the file in a folder atomically; its path. `others`: hashes of files elsewhere that it is made from.

        ValueError where a number is not finite, OSError, InputError where the folder's chain was altered.
        """
        path = folder / (name or self.FILE)
        data = self.text().encode()
        if self.CHAINED:
            known = {key: getattr(self, key) for key in ("unit", "run")} if self.ROOT else {}
            _chain().put(folder, {path.name: data}, self.MADE_FROM, others=others, **known)
        else:
            write_atomically(path, data)
        return path


def _chain() -> ModuleType:
    """The module of the chain, which itself is a record."""
    from bench.record import chain

    return chain


def _wrong(error: ValidationError) -> str:
    """The first thing wrong: where, what stands there, what is allowed."""
    first = error.errors(include_url=False)[0]
    where = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in first["loc"]).lstrip(".")
    if first["type"] == "missing":
        return f"key '{where}' is missing"
    value = json.dumps(first["input"], default=str)
    shown = value if len(value) <= _SHOWN else f"{value[:_SHOWN]}…"
    return f"{where} is {shown}: {first['msg'][0].lower()}{first['msg'][1:]}"
