"""Profile and equipment in, run folder out: profile, station, recording, run, and the import of foreign logs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
