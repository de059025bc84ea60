"""Programs beside Python that some tests need, and the Debian packages that bring them."""

import shutil

PACKAGES = {
    "chromium": "chromium",
    "curl": "curl",
    "gcc": "gcc",
    "mbpoll": "mbpoll",
    "objcopy": "binutils",
    "openssl": "openssl",
    "pdftotext": "poppler-utils",
    "pg_ctlcluster": "postgresql",
}


def hint():
    """The command that brings what is missing here; empty where nothing is."""
    missing = sorted({package for program, package in PACKAGES.items() if shutil.which(program) is None})
    return f"apt-get install {' '.join(missing)}" if missing else ""
