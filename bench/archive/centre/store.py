"""The centre as a place for files: a folder, S3, SFTP, or whatever else fsspec reaches.

    centre.json                                    what this place is
    archives/<archive>.json                        which folder of which computer sends under this id
    ledgers/<archive>/<bytes>-<sha256>.jsonl       the ledger of an archive, as long as it was
    files/<two digits>/<sha256>                    the content of a file, under its hash
    entries/<archive>/<unit>/<folder>/<number>-<manifest>-<digest>.json    a folder: its files by their hashes

A file is written under another name and renamed, or put in one step where the place does that (S3). The entry of a
folder is written last, so that it lists only what is there. Nothing is ever replaced or removed but what `scrub` finds
damaged.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

from bench.base import BenchError, CentreError, InputError
from bench.record import sha256, share

Tell = Callable[[str], None]
"""Takes a line about what is being done."""
MARK = "centre.json"
_BLOCK = 1 << 20
_ATOMIC = {"s3", "s3a", "gs", "gcs", "abfs", "az", "memory"}
"""What is put there appears whole or not at all, and renaming would copy it."""
_LIBRARIES = {"botocore", "aiobotocore", "aiohttp", "s3fs", "asyncssh", "sshfs", "fsspec", "socket"}
"""Whose errors say that the place cannot be reached or refuses."""
_PATIENCE = {"s3": {"config_kwargs": {"connect_timeout": 10, "read_timeout": 60, "retries": {"max_attempts": 3}}}}


class DamagedError(CentreError):
    """The centre is reached, and has lost or damaged a file."""


class Centre:
    """An open centre; `url` carries no password and may be printed."""

    def __init__(self, url: str, *, begin: bool = False) -> None:
        """`begin` makes one of an empty place. InputError where it is none, CentreError where it is not reached."""
        self.url = named(url)
        try:
            from fsspec.core import url_to_fs

            protocol = url.partition("://")[0] if "://" in url else "file"
            self._fs, root = url_to_fs(url, **_PATIENCE.get(protocol, {}))
        except (ImportError, ValueError) as error:
            extra = {"s3": "s3", "ssh": "sftp", "sftp": "sftp"}.get(url.partition("://")[0], "")
            hint = f"; pip install 'gyro-thermal-bench[{extra}]'" if extra else ""
            raise InputError(f"no such kind of place ({error}){hint}", self.url) from None
        except Exception as error:
            raise self._unreached(error) from error
        self._root = root.rstrip("/")
        self._atomic, self._local = protocol in _ATOMIC, protocol in {"file", "local"}
        self._made: set[str] = set()
        if not self.has(MARK):
            self._begin(begin)

    def has(self, name: str) -> bool:
        """Whether there is a file of this name."""
        return self.size(name) is not None

    def size(self, name: str) -> int | None:
        """Length of a file [bytes]; None where there is none."""
        with self._asked():
            try:
                return int(self._fs.info(self._path(name))["size"])
            except FileNotFoundError:
                return None

    def names(self, folder: str) -> list[str]:
        """Every file below a folder, by its name in the centre, in order."""
        with self._asked():
            self._fs.invalidate_cache()
            cut = len(self._fs._strip_protocol(self._root)) + 1
            return sorted(str(path)[cut:] for path in self._fs.find(self._path(folder)))

    def read(self, name: str) -> bytes:
        """A short file."""
        with self._asked():
            data: bytes = self._fs.cat_file(self._path(name))
            return data

    def write(self, name: str, data: bytes) -> None:
        """A short file, whole."""
        with self._whole(name) as place:
            self._fs.pipe_file(place, data)

    def remove(self, name: str) -> None:
        """Remove a file, which may be gone."""
        with self._asked(), suppress(FileNotFoundError):
            self._fs.rm_file(self._path(name))

    def move(self, name: str, other: str) -> None:
        """Give a file another name."""
        with self._asked():
            self._fs.makedirs(self._parent(other), exist_ok=True)
            self._fs.mv(self._path(name), self._path(other))

    def put(self, digest: str, source: Path) -> int:
        """Send a file whose SHA-256 must be `digest`; the bytes that travelled, 0 where it is there already.

        InputError where the file has other contents, or changes meanwhile.
        """
        stamp = _stamp(source)
        if self.size(content(digest)) == stamp[0]:
            return 0
        found = sha256(source)
        if found != digest:
            raise InputError(f"is not the file that was recorded: its SHA-256 is {found}, not {digest}", source)
        with self._whole(content(digest)) as place:
            self._fs.put_file(str(source), place)
            same = _stamp(source) == stamp and self._fs.info(place)["size"] == stamp[0]
            if not same:
                self._fs.rm_file(place)
                raise InputError("changed while it was sent; send it again", source)
        return stamp[0]

    def get(self, digest: str, target: Path) -> None:
        """Bring a file, and prove it by its hash; CentreError where it is missing or damaged.

        From a folder on the same disk it comes as another name of the same file.
        """
        place = self._path(content(digest))
        with self._asked():
            if not (self._local and share(Path(place), target)):
                try:
                    self._fs.get_file(place, str(target))
                except FileNotFoundError:
                    raise DamagedError(f"centre {self.url}: {content(digest)} is missing; {_SCRUB}") from None
        if sha256(target) != digest:
            target.unlink()
            raise DamagedError(f"centre {self.url}: {content(digest)} is damaged; {_SCRUB}")

    def hashed(self, digest: str) -> str | None:
        """The SHA-256 that a file has now, read anew at the centre; None where it is missing."""
        found = hashlib.sha256()
        with self._asked():
            try:
                with self._fs.open(self._path(content(digest)), "rb") as file:
                    while block := file.read(_BLOCK):
                        found.update(block)
            except FileNotFoundError:
                return None
        return found.hexdigest()

    def _begin(self, begin: bool) -> None:
        with self._asked():
            found = self._fs.ls(self._root, detail=False) if self._fs.exists(self._root) else []
            # A bench that was killed, or begins at the same moment, has left something in tmp.
            others = [path for path in found if path.rstrip("/").rpartition("/")[2] != "tmp"]
        if not begin:
            raise InputError("is no centre: centre.json is missing; `bench sync send` makes one", self.url)
        if others:
            self._fs.invalidate_cache()
            if self.has(MARK):  # another bench has begun it at this moment
                return
            raise InputError("holds other files; name an empty place for a new centre", self.url)
        self.write(MARK, b'{"kind": "centre", "format": 1}\n')

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _parent(self, name: str) -> str:
        return self._path(name).rpartition("/")[0]

    @contextmanager
    def _whole(self, name: str) -> Iterator[str]:
        """Where to write a file that gets its name when it is complete."""
        place = self._path(name if self._atomic else f"tmp/{uuid.uuid4().hex}")
        with self._asked():
            for folder in {self._parent(name), place.rpartition("/")[0]} - self._made:
                if not self._atomic:
                    self._fs.makedirs(folder, exist_ok=True)
                self._made.add(folder)
            try:
                yield place
                if not self._atomic:
                    self._settle(place, self._path(name))
            except BaseException:
                if not self._atomic:
                    with suppress(Exception):  # the first error is told
                        self._fs.rm_file(place)
                raise

    def _settle(self, place: str, path: str) -> None:
        if self._local:
            handle = os.open(place, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
            Path(place).replace(path)
            return
        self._fs.mv(place, path)

    @contextmanager
    def _asked(self) -> Iterator[None]:
        try:
            yield
        except BenchError:
            raise
        except Exception as error:
            if isinstance(error, OSError) or type(error).__module__.partition(".")[0] in _LIBRARIES:
                raise self._unreached(error) from error
            raise

    def _unreached(self, error: Exception) -> CentreError:
        lines = str(error).strip().splitlines() or [""]
        return CentreError(f"centre {self.url}: {type(error).__name__}: {lines[0]}; run the command again later")


_SCRUB = "`bench sync scrub --repair` sets it aside, and a bench that has it sends it again"


def content(digest: str) -> str:
    """Name of the file with this SHA-256."""
    return f"files/{digest[:2]}/{digest}"


def named(url: str) -> str:
    """What a centre is called: without the password, a folder by its whole path."""
    if "://" not in url:
        return str(Path(url).absolute())
    if "@" not in url:
        return url
    parts = urlsplit(url)
    user, _, host = parts.netloc.rpartition("@")
    return urlunsplit(parts._replace(netloc=f"{user.partition(':')[0]}@{host}"))


def _stamp(path: Path) -> tuple[int, int, int]:
    try:
        found: Any = path.stat()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path) from None
    return found.st_size, found.st_mtime_ns, found.st_ino
