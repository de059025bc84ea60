"""The key of this bench: made once, kept outside the archive, and what it signs.

A folder of this user holds `bench.key` (Ed25519, private) and `bench.pub`; every other `*.pub` in it is a key of
another bench that this one trusts. `BENCH_KEYS` names another folder.
"""

from __future__ import annotations

import contextlib
import os
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

PRIVATE, PUBLIC = "bench.key", "bench.pub"


def keys_folder() -> Path:
    """Where the keys are."""
    if given := os.environ.get("BENCH_KEYS"):
        return Path(given)
    config = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(config) / "gyro-thermal-bench"


def public_key() -> str:
    """Public key of this bench, hexadecimal; empty where it can neither find nor make its key."""
    with contextlib.suppress(OSError, ValueError, RuntimeError):
        return _own(str(keys_folder()))[1]
    return ""


def sign(content: bytes) -> str:
    """Signature of this bench, hexadecimal; empty where it can neither find nor make its key."""
    with contextlib.suppress(OSError, ValueError, RuntimeError):
        return _own(str(keys_folder()))[0].sign(content).hex()
    return ""


def signed(content: bytes, public: str, signature: str) -> bool:
    """Whether the signature is that of this key over this content."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(public)).verify(bytes.fromhex(signature), content)
    except (InvalidSignature, ValueError):
        return False
    return True


def trusted() -> frozenset[str]:
    """Public keys that this bench trusts: its own and those in its folder."""
    found = set()
    with contextlib.suppress(OSError, RuntimeError):
        for path in keys_folder().glob("*.pub"):
            found.add(path.read_text(encoding="utf-8", errors="replace").strip())
    return frozenset(found)


@lru_cache(maxsize=8)
def _own(folder: str) -> tuple[Ed25519PrivateKey, str]:
    from cryptography.hazmat.primitives.asymmetric import ed25519
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

    path = Path(folder) / PRIVATE
    if not path.exists():
        _make(path)
    key = load_pem_private_key(path.read_bytes(), None)
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise ValueError("not an Ed25519 key")
    public = key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex()
    if not (shown := path.with_name(PUBLIC)).exists():
        shown.write_text(f"{public}\n", encoding="utf-8")
    return key, public


def _make(path: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    key = Ed25519PrivateKey.generate()
    keep_secret(path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))


def keep_secret(path: Path, data: bytes) -> None:
    """A new file that only this user reads; where two processes make one at once, the first one counts. OSError."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        os.write(handle, data)
        os.fsync(handle)
    finally:
        os.close(handle)
    try:
        with contextlib.suppress(FileExistsError):
            path.hardlink_to(partial)
    except OSError:  # no hard links here
        if not path.exists():
            partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
