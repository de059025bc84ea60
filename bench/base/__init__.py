"""What every other wing stands on: errors, channels, strict YAML and settings, numbers in print, versions."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
