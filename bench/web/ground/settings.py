"""Settings of a server, fixed at its start; routes read them from `app.state`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Settings:
    """Settings of one server: folders, access, address."""

    out: Path
    """Root of the run folders, `<unit>/<run>` below it."""
    registry: str | None = None
    """Another registry than the file in `out`."""
    project: Path = field(default_factory=Path.cwd)
    """Folder with the user's own `profiles/`; runs are started in it."""
    access: Path | None = None
    """Access file with tokens and roles. None: users of this computer are engineers, others have no access."""
    host: str = LOOPBACK
    """The address that the server is bound to."""
    names: tuple[str, ...] = ()
    """Further host names of this server in requests."""
    behind: str | None = None
    """Address of a reverse proxy, which says for whom it asks (X-Forwarded-For, X-Forwarded-Proto)."""
    secure: bool = False
    """Served over TLS; cookies are then sent over TLS only."""
    body_bytes: int = 1 << 20
    """Largest request other than an import [bytes]."""
    upload_bytes: int = 4 << 30
    """Largest import [bytes]."""

    @property
    def own(self) -> Path:
        """Folder of the server's own files, made if missing; other users cannot read it."""
        folder = self.out / ".web"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return folder


async def _settings(request: Request) -> Settings:
    settings: Settings = request.app.state.settings
    return settings


Here = Annotated[Settings, Depends(_settings)]
"""A parameter of a route that needs the settings: `def runs(here: Here)`."""
