from .base.versions import __version__ as __version__
