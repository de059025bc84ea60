"""The run folder, its tables and its records: the border between acquisition and analysis."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
