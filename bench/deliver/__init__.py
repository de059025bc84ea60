"""What leaves the bench: report, certificate, and the coefficients in the forms that a unit takes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
