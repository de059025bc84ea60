"""Settings of the documentation site: `sphinx-build -W --keep-going -n -b html docs <out>`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import bench

if TYPE_CHECKING:
    from docutils.nodes import Element, TextElement
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "Thermal test bench for gyroscopes"
author = "the authors of gyro-thermal-bench"
version = release = bench.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_click", "schema_tables", "notebook_pages"]
html_theme = "furo"
html_title = f"Thermal test bench {release}"
html_show_copyright = False
html_copy_source = False
smartquotes = False  # `--option` stays two hyphens
default_role = "code"  # docstrings and help texts quote code with single backticks
highlight_language = "none"  # a block without a language is output, not Python

myst_heading_anchors = 4  # the anchors that GitHub gives the same headings; a link to a missing one is a warning

PUBLIC = tuple(getattr(bench, "__all__", ()))
for _name in PUBLIC:
    setattr(bench, _name, getattr(bench, _name))  # names are loaded on demand, and autodoc sees only loaded ones
autodoc_typehints = "description"
autodoc_member_order = "bysource"
# Only names of the public API have a page; the build asks no network for those of other projects.
nitpick_ignore_regex = [("py:.*", r"(?!bench\.\w+$).*")]


def public_name(app: Sphinx, env: BuildEnvironment, node: pending_xref, text: TextElement) -> Element | None:
    """Link a class in a signature to the name that users import; signatures name the module that defines it."""
    name = str(node.get("reftarget")).rsplit(".", 1)[-1]
    if node.get("refdomain") != "py" or name not in PUBLIC:
        return None
    python = env.domains.python_domain
    return python.resolve_xref(env, node["refdoc"], app.builder, node["reftype"], f"bench.{name}", node, text)


def setup(app: Sphinx) -> None:
    """Connect the hook above."""
    app.connect("missing-reference", public_name)
