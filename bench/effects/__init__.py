"""Physical effects, one a file. `registry.py` lists them, `base.py` says what an effect is."""

from bench.effects.catalogue import Entry, catalogue, entry, markdown
from bench.effects.registry import doc, get, load_effect, make, names, nearest, register, shapes, suited
from bench.effects.signature import Signature, signature

__all__ = [
    "Entry",
    "Signature",
    "catalogue",
    "doc",
    "entry",
    "get",
    "load_effect",
    "make",
    "markdown",
    "names",
    "nearest",
    "register",
    "shapes",
    "signature",
    "suited",
]
