"""What a server was told at its start; every router reads it from `app.state`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Settings:
    """One server: where the runs are, who may look, under which names it is asked."""

    out: Path
    """Root of the run folders, `<unit>/<run>` below it."""
    project: Path = field(default_factory=Path.cwd)
    """Folder with the user's own `profiles/`; runs are started in it."""
    access: Path | None = None
    """Access file: tokens and roles. None: everybody on this machine, and nobody else, is an engineer."""
    host: str = LOOPBACK
    """The address that the server is bound to."""
    names: tuple[str, ...] = ()
    """Further names by which browsers may ask for this server."""
    secure: bool = False
    """Served over TLS: cookies are sent over nothing else."""
    body_bytes: int = 1 << 20
    """Largest request that is not an import."""
    upload_bytes: int = 4 << 30
    """Largest import."""

    @property
    def own(self) -> Path:
        """Folder of the server's own files, made where missing; nobody else may look into it."""
        folder = self.out / ".web"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return folder


def _settings(request: Request) -> Settings:
    settings: Settings = request.app.state.settings
    return settings


Here = Annotated[Settings, Depends(_settings)]
"""A parameter of a route that wants the settings: `def runs(here: Here)`."""
