"""The bench in tests of other projects: simulated equipment and whole runs as fixtures of pytest."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
