"""Physical effects, one a file. `registry.py` lists them, `base.py` says what an effect is."""

from bench.analysis.effects.catalogue import CatalogueEntry, catalogue, entry, markdown
from bench.analysis.effects.registry import doc, effect_names, get, load_effect, make, register
from bench.analysis.effects.signature import Signature, signature

__all__ = [
    "CatalogueEntry",
    "Signature",
    "catalogue",
    "doc",
    "effect_names",
    "entry",
    "get",
    "load_effect",
    "make",
    "markdown",
    "register",
    "signature",
]
