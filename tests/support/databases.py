"""A PostgreSQL server of its own for the tests: a new cluster under an unprivileged user, on a unix socket only."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def binaries() -> Path | None:
    """Folder of initdb and postgres, the newest version of Debian's package; None without."""
    found = shutil.which("initdb")
    if found:
        return Path(found).parent
    folders = [path.parent for path in Path("/usr/lib/postgresql").glob("*/bin/initdb")]
    return max(folders, key=lambda path: int(path.parent.name), default=None)


@contextmanager
def postgres(programs: Path) -> Iterator[str]:
    """Start a server; gives the URL of its folder, to which a database's name is put by `database`."""
    folder = Path(tempfile.mkdtemp(prefix="pg-", dir="/tmp"))  # short: a socket's path is limited to 107 bytes
    account = _unprivileged()
    try:
        if account:
            os.chown(folder, account["user"], account["group"])
        data = folder / "data"
        _call(
            [programs / "initdb", "-D", data, "-U", "bench", "-A", "trust", "-N", "-E", "UTF8", "--locale=C"], account
        )
        options = f"-c listen_addresses='' -c unix_socket_directories={folder} -c fsync=off -c max_connections=50"
        control = [programs / "pg_ctl", "-D", data, "-w", "-l", folder / "log"]
        _call([*control, "-o", options, "start"], account)
        try:
            yield f"postgresql://bench@/postgres?host={folder}"
        finally:
            _call([*control, "-m", "immediate", "stop"], account)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def database(server: str, name: str) -> str:
    """URL of a new, empty database of the server."""
    import psycopg

    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')  # type: ignore[arg-type]
    return server.replace("/postgres?", f"/{name}?")


def _unprivileged() -> dict[str, Any]:
    """Whom to run as: PostgreSQL refuses to run as root."""
    if os.geteuid() != 0:
        return {}
    known = {entry.pw_name: entry for entry in pwd.getpwall()}
    entry = known.get("postgres") or known["nobody"]
    return {"user": entry.pw_uid, "group": entry.pw_gid, "extra_groups": []}


def _call(command: list[Any], account: dict[str, Any]) -> None:
    done = subprocess.run(
        [str(word) for word in command], cwd="/", check=False, text=True, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE if "start" not in command else subprocess.DEVNULL, stderr=subprocess.STDOUT, **account,
    )  # fmt: skip
    assert done.returncode == 0, f"{command[0]}: {done.stdout}"
