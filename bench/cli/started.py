"""A run that a server started: `bench run` in a process that outlives it.

`python -m bench.cli.started FOLDER LOCK ARGUMENT…`. This process holds the lock, an open file that it inherits from the
server, until it ends, so that any server can detect it; then it writes its exit code to FOLDER.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from bench.record import write_atomically
from bench.web import EXIT


def main(folder: Path, lock: int, arguments: list[str]) -> int:
    """Run `bench` with these arguments; its exit code."""
    os.set_inheritable(lock, False)  # a watchdog that outlives the run must not hold the lock
    code = 4
    try:
        from bench.cli import main as bench

        bench(arguments, prog_name="bench")
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    finally:
        sys.stdout.flush()
        write_atomically(folder / EXIT, f"{code}\n".encode())
    return code


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
