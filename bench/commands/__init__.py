"""What the commands do, one function each; text and exit codes are made in `bench.cli`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
