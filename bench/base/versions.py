"""The version of the bench, and the versions of everything that makes its numbers."""

from __future__ import annotations

import platform

__version__ = "0.1.0"
RECORDED_PACKAGES = ("numpy", "scipy", "pandas", "pymodbus", "python-can", "cantools", "pyarrow")


def package_versions() -> dict[str, str]:
    """Versions of everything that made the numbers."""
    from importlib.metadata import PackageNotFoundError, version  # slow, and in the way of `bench --help`

    found = {"bench": __version__, "python": platform.python_version()}
    for package in RECORDED_PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found
