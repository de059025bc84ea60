"""Run folders in, answers out: noise, effects, fit, diagnosis, and the judging of a run. Needs no equipment."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
