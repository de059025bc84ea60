"""The bench in a browser: one page application and the HTTP API behind it.

The server reads run folders and the files of live runs, and starts runs as processes of their own; no run depends
on it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
