"""The bench from Python: runs, fits, comparisons and diagnoses as objects; `import bench` gives these names."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
