"""Files that are replaced whole: a reader or a power cut sees the old one or the new one."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.base import process_alive, sync_folder

_STAGED = re.compile(r"\.staged-(\d+)-.+")
"""Names of folders of `staged`, with the number of the process that made them."""
_PARTIAL = re.compile(r"\..+\.(?:json|jsonl|yaml|html|parquet|gtbj|pdf|xml)\.(?:part|[a-z0-9_]{8})")
"""Names of files that are not whole yet, as `write_atomically` and `copy_whole` give them."""


def write_atomically(path: Path, data: bytes, *, sync: bool = True, mode: int = 0o644) -> None:
    """Replace `path` by `data` so that a reader or a power cut sees the old file or the new one, never a part.

    Without `sync` a power cut may bring the old one back.
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            if sync:
                os.fsync(file.fileno())
        Path(temporary).chmod(mode)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    if sync:
        sync_folder(path.parent)


def clear_partial(folder: Path) -> None:
    """Remove what killed writers left in a folder: files that have no name of their own yet."""
    for file in folder.iterdir():
        if _PARTIAL.fullmatch(file.name):
            file.unlink(missing_ok=True)


@contextmanager
def staged(root: Path) -> Iterator[Path]:
    """A folder in `root` for what is moved to its place when it is complete; gone afterwards.

    Those that killed processes of this computer left are removed first.
    """
    root.mkdir(parents=True, exist_ok=True)
    for left in root.glob(".staged-*"):
        maker = _STAGED.fullmatch(left.name)
        if maker is not None and not process_alive(int(maker[1])):
            shutil.rmtree(left, ignore_errors=True)
    place = Path(tempfile.mkdtemp(dir=root, prefix=f".staged-{os.getpid()}-"))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def share(source: Path, target: Path) -> bool:
    """Make `target` another name of the file `source`; False where the file system has no hard links."""
    try:
        target.hardlink_to(source)
    except OSError:
        return False
    return True


def share_again(source: Path, target: Path) -> None:
    """Make `target`, which exists, another name of the file `source`; it stays what it is where that fails."""
    partial = target.with_name(f".{target.name}.part")
    partial.unlink(missing_ok=True)
    if share(source, partial):
        partial.replace(target)


def copy_whole(source: Path, target: Path) -> None:
    """Copy a file so that `target` is never seen in part."""
    partial = target.with_name(f".{target.name}.part")
    shutil.copyfile(source, partial)
    partial.replace(target)


def sha256(path: Path) -> str:
    """SHA-256 of a file's contents, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
