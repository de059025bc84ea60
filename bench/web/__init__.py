"""The bench in a browser: a single-page application and the HTTP API behind it.

The server reads run folders and the files of live runs, and starts each run in a separate process; no run depends on
the server.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
