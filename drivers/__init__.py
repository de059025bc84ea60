"""Equipment of the bench: chambers over Modbus, gyros over CAN, and their simulators. Never imports bench."""

import importlib
import sys
import types
from typing import Any

_LOGS = "can.io.mf4"


def _later(name: str) -> type:
    """A class in the place of `name` of python-can's module of MF4 logs, which is imported when one is made."""

    def make(cls: type, *args: Any, **options: Any) -> Any:
        if isinstance(sys.modules.get(_LOGS), _Logs):
            del sys.modules[_LOGS]
        return getattr(importlib.import_module(_LOGS), name)(*args, **options)

    return type(name, (), {"__new__": make})


class _Logs(types.ModuleType):
    """python-can imports this module at once, and with it asammdf, pandas and sympy: a second in every process."""

    MF4Reader, MF4Writer = _later("MF4Reader"), _later("MF4Writer")


if "can" not in sys.modules:
    sys.modules[_LOGS] = _Logs(_LOGS)
