"""Opens a registry, an SQLite file or a PostgreSQL URL, and updates its schema under a lock."""

from __future__ import annotations

import sqlite3
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event, inspect, make_url, text
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError

from bench.base import InputError

FILE = "registry.sqlite"
"""File name of the registry beside the run folders."""

SCHEMA = "0008"
"""Newest migration in `migrations/versions`."""

WAIT_S = 60.0
"""How long a station waits while another one writes [s]."""
_PAUSE_S = 0.01
"""Before it asks again where SQLite does not wait."""

_AGAIN = "move it away, and make it again with `bench registry rebuild`"

_CHECKED_BYTES = 256 << 20
"""Size of the largest file whose structure is checked each time that it is opened: some 80,000 runs."""

_MIGRATIONS = Path(__file__).parent / "migrations"
_LOCK = 0x6779726F
"""Number of PostgreSQL's advisory lock around a migration ("gyro")."""


class Registry:
    """An open registry; `url` carries no password and may be printed."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.url = engine.url.render_as_string(hide_password=True)

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that writes; on SQLite it locks out other writers from its start. InputError where it fails."""
        with self._told(), self._engine.begin() as connection:
            yield connection

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that only reads and blocks nobody."""
        with self._told(), self._engine.connect().execution_options(reads=True) as connection:
            yield connection

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except SQLAlchemyError as error:
            broken = f"; {_AGAIN}" if "malformed" in str(error) else ""
            raise InputError(f"registry: {_first_line(error)}{broken}", self.url) from error

    def inside(self, folder: Path) -> bool:
        """Whether it is a file in this folder, which moves and is copied with it."""
        url = self._engine.url
        own = url.get_backend_name() == "sqlite" and url.database
        return bool(own) and Path(str(own)).resolve().parent == folder.resolve()

    @property
    def bytes(self) -> int:
        """Size of an SQLite file; 0 of anything else, or where there is none yet."""
        url = self._engine.url
        path = Path(str(url.database))
        return path.stat().st_size if url.get_backend_name() == "sqlite" and path.is_file() else 0

    def refuse_damaged(self) -> None:
        """InputError where the structure of an SQLite file is broken."""
        if not self.bytes:
            return
        with self.reading() as connection:
            said = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar()
        if said != "ok":
            raise InputError(f"registry: is damaged ({str(said).splitlines()[-1]}); {_AGAIN}", self.url)

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()

    def __enter__(self) -> Registry:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_registry(where: str | Path, *, checked: bool = False) -> Registry:
    """The registry at a file or URL, made if missing and updated to the schema of this bench.

    `checked`: the structure of an SQLite file is checked first, unless it is so large that this takes seconds.

    Raises InputError: not reachable, driver missing, not a registry, or a schema newer than this bench.
    """
    url = _url(where)
    try:
        engine = _engine(url)
    except (ArgumentError, NoSuchModuleError, ModuleNotFoundError) as error:
        hint = "; install it with pip install 'gyro-thermal-bench[postgres]'" if "psycopg" in str(error) else ""
        raise InputError(f"registry: {_first_line(error)}{hint}", url.render_as_string()) from None
    registry = Registry(engine)
    try:
        if checked and registry.bytes <= _CHECKED_BYTES:
            registry.refuse_damaged()
        _bring_up_to_date(registry)
    except BaseException:
        registry.close()
        raise
    return registry


def _url(where: str | Path) -> URL:
    given = str(where)
    if "://" not in given:
        parent = Path(given).parent
        if not parent.is_dir():
            raise InputError("registry: its folder does not exist", parent)
        return URL.create("sqlite", database=given)
    try:
        url = make_url(given)
    except (ArgumentError, ValueError):
        raise InputError(
            "registry: not a URL; use a file, or postgresql://user@host/name", given.partition("@")[2] or given
        ) from None
    return url.set(drivername="postgresql+psycopg") if url.drivername in {"postgres", "postgresql"} else url


def _engine(url: URL) -> Engine:
    if url.get_backend_name() == "postgresql":
        return create_engine(url, connect_args={"connect_timeout": 10}, pool_pre_ping=True)
    if url.get_backend_name() != "sqlite":
        raise ArgumentError(f"{url.get_backend_name()} is not supported; use an SQLite file or PostgreSQL")
    engine = create_engine(url, connect_args={"timeout": WAIT_S})

    @event.listens_for(engine, "connect")
    def _prepare(connection: Any, _: object) -> None:
        connection.isolation_level = None  # `_begin` begins transactions, not the driver
        for pragma in (f"busy_timeout={round(WAIT_S * 1000)}", "foreign_keys=ON", "synchronous=NORMAL"):
            connection.execute(f"PRAGMA {pragma}")
        _write_ahead(connection)

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        # SQLite refuses a transaction that reads first and writes later when another one wrote in between.
        reads = connection.get_execution_options().get("reads")
        connection.exec_driver_sql("BEGIN" if reads else "BEGIN IMMEDIATE")

    return engine


def _write_ahead(connection: Any) -> None:
    """Have SQLite write ahead: while another station writes, it refuses that at once, whatever its timeout."""
    until_s = time.monotonic() + WAIT_S
    while connection.execute("PRAGMA journal_mode").fetchone() != ("wal",):
        try:
            connection.execute("PRAGMA journal_mode=WAL")
        except sqlite3.OperationalError:
            if time.monotonic() > until_s:
                raise
            time.sleep(_PAUSE_S)
        else:
            return  # where the file system does not allow it, SQLite stays as it is


def _bring_up_to_date(registry: Registry) -> None:
    with registry.reading() as connection:
        if _schema(connection, registry.url) == SCHEMA:
            return
    from alembic import command
    from alembic.config import Config

    with registry.writing() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
        if _schema(connection, registry.url) != SCHEMA:  # another station may have updated it while this one waited
            config = Config()
            config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
            from bench.archive.registry.summaries import summarise

            summarise(connection, tell=lambda done, units: _tell(registry.url, done, units))


def _tell(url: str, done: int, units: int) -> None:
    print(f"bench: {url}: is updated once for this bench: {done:,} of {units:,} units", file=sys.stderr, flush=True)


def _schema(connection: Connection, url: str) -> str | None:
    """Revision of the schema, None for an empty database; InputError for a revision that this bench does not know."""
    found = inspect(connection).get_table_names()
    if "alembic_version" not in found:
        if found:
            raise InputError(f"registry: holds other tables ({', '.join(sorted(found)[:3])}); name another one", url)
        return None
    revision = connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
    known = {path.name.partition("_")[0] for path in (_MIGRATIONS / "versions").glob("[0-9]*_*.py")}
    if revision is not None and revision not in known:
        raise InputError(
            f"registry: its schema {revision} is newer than this bench knows ({SCHEMA}); update the bench, or name "
            "another registry with --registry",
            url,
        )
    return None if revision is None else str(revision)


def _first_line(error: BaseException) -> str:
    cause = getattr(error, "orig", None) or error
    return str(cause).strip().partition("\n")[0] or type(cause).__name__
