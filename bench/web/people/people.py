"""The access file: names, roles and the hashes of their tokens."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import tempfile
import threading
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from bench.base import STRICT, InputError, dump, load_config

Role = Literal["viewer", "operator", "engineer"]

NAME = r"^[^\W_](?:[\w .@'-]{0,38}[\w.])?$"
_BYTES = 32
"""Random bytes of a token: enough that a plain SHA-256 is as safe as a slow hash."""
PIN_MOST = 40
_PIN_DIGITS, _PIN_LEAST = 6, 4
_HEAD = "# Who may use `bench ui`. This file holds the SHA-256 of each token; a token without an entry is not valid.\n"


class Person(BaseModel):
    """A user of the server."""

    model_config = STRICT

    name: Annotated[str, Field(pattern=NAME)]
    """Name in the events of a run."""
    role: Role
    """viewer looks; operator starts, holds and aborts; engineer also analyses and imports."""
    token_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    """SHA-256 of the token, as hexadecimal digits."""
    pin_scrypt: Annotated[str, Field(pattern=r"^([0-9a-f]{32}:[0-9a-f]{64})?$")] = ""
    """Salt and scrypt of a PIN or badge; it names the person on a screen that is signed in, and gives no more than an
    operator's role.
    """


class AccessFile(BaseModel):
    """The content of the access file."""

    model_config = STRICT

    people: list[Person]
    """All users; a user may have several tokens."""


class People:
    """The access file, read again when it changes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._seen: tuple[int, int, int] | None = None
        self._by_hash: dict[str, Person] = {}
        self._refresh()

    def by_token(self, token: str) -> Person | None:
        """Owner of this token."""
        return self.by_hash(hashlib.sha256(token.encode(errors="replace")).hexdigest())

    def by_hash(self, digest: str) -> Person | None:
        """Owner of the token with this SHA-256."""
        self._refresh()
        found = None
        for known, person in self._by_hash.items():  # compare with all, so that the time reveals nothing
            if hmac.compare_digest(known, digest):
                found = person
        return found

    def by_pin(self, pin: str) -> Person | None:
        """Owner of this PIN or badge."""
        self._refresh()
        return next((person for person in self._by_hash.values() if _is_pin(pin, person)), None)

    @property
    def have_pins(self) -> bool:
        """Whether anybody has a PIN or a badge."""
        self._refresh()
        return any(person.pin_scrypt for person in self._by_hash.values())

    def _refresh(self) -> None:
        with self._lock:
            try:
                stat = self._path.stat()
            except OSError as error:
                self._by_hash, self._seen = {}, None
                raise InputError(_missing(self._path), self._path) from error
            seen = (stat.st_mtime_ns, stat.st_size, stat.st_ino)
            if seen != self._seen:
                self._by_hash = {}  # nobody has access while the file cannot be read
                self._by_hash = {person.token_sha256: person for person in read(self._path).people}
                self._seen = seen


def _missing(path: Path) -> str:
    return f"no access file; `bench ui --access {path} --new-token NAME --role engineer` makes one"


def read(path: Path) -> AccessFile:
    """The access file; InputError where it is not valid or other users may write it."""
    if not path.is_file():
        raise InputError(_missing(path), path)
    if os.name == "posix" and path.stat().st_mode & 0o022:
        raise InputError(f"others may write this access file; `chmod 600 {path}`", path)
    return load_config(path, AccessFile)


def add_person(path: Path, name: str, role: Role) -> str:
    """Make a token for a user and store its hash; returns the token, which is stored nowhere."""
    token = secrets.token_urlsafe(_BYTES)
    _add(path, name, role, token)
    return token


def add_pin(path: Path, name: str, role: Role, badge: str | None = None) -> str:
    """Make a PIN for a user, or take the number on a badge, and store its hash; returns it."""
    people = read(path).people if path.exists() else []
    pin = badge if badge is not None else f"{secrets.randbelow(10**_PIN_DIGITS):0{_PIN_DIGITS}}"
    while badge is None and any(_is_pin(pin, person) for person in people):
        pin = f"{secrets.randbelow(10**_PIN_DIGITS):0{_PIN_DIGITS}}"
    if not _PIN_LEAST <= len(pin) <= PIN_MOST or not pin.isprintable():
        raise InputError(f"--badge has {len(pin)} characters, must have {_PIN_LEAST} to {PIN_MOST} visible ones", path)
    if owner := next((person.name for person in people if _is_pin(pin, person)), None):
        raise InputError(f"this badge is that of {owner}; nobody else can have it", path)
    salt = secrets.token_hex(16)
    _add(path, name, role, secrets.token_urlsafe(_BYTES), f"{salt}:{_scrypt(pin, salt)}")
    return pin


def _is_pin(pin: str, person: Person) -> bool:
    salt, _, known = person.pin_scrypt.partition(":")
    return bool(known) and hmac.compare_digest(_scrypt(pin, salt), known)


def _scrypt(pin: str, salt: str) -> str:
    return hashlib.scrypt(pin.encode(errors="replace"), salt=bytes.fromhex(salt), n=1 << 12, r=8, p=1, dklen=32).hex()


def _add(path: Path, name: str, role: Role, token: str, pin_scrypt: str = "") -> None:
    if not re.match(NAME, name):
        raise InputError(f"name is {name!r}, must be up to 40 letters, digits, spaces or . @ ' -", path)
    people = read(path).people if path.exists() else []
    digest = hashlib.sha256(token.encode()).hexdigest()
    new = Person(name=name, role=role, token_sha256=digest, pin_scrypt=pin_scrypt)
    content = {"people": [person.model_dump(exclude_defaults=True) for person in (*people, new)]}
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")  # mode 0600
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(_HEAD + dump(content))
        Path(temporary).replace(path)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", path) from error
