"""Strict YAML for the files of a user (`drivers.yaml12`), with errors that name file and line."""

from __future__ import annotations

from pathlib import Path

from bench.base.errors import InputError
from drivers import yaml12
from drivers.yaml12 import Document, Place, PlacedError, dump

__all__ = ["Document", "Place", "PlacedError", "dump", "parse_yaml", "read_text", "read_yaml"]


def parse_yaml(text: str, file: Path | str) -> Document:
    """Parse YAML text; `file` is only named in errors. InputError with the line for anything outside strict YAML."""
    try:
        return yaml12.parse(text, file)
    except yaml12.YamlError as error:
        raise InputError(str(error), file, error.line) from None


def read_yaml(path: Path | str) -> Document:
    """Read and parse a YAML file; InputError when it cannot be read."""
    return parse_yaml(read_text(path), path)


def read_text(path: Path | str) -> str:
    """Text of a file [UTF-8]; InputError when it is missing, a folder, or not text."""
    try:
        return Path(path).read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError("no such file", path) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError("is not text in UTF-8; save it as UTF-8", path, line) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path) from None
