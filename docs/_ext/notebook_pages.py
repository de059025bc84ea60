"""Notebooks as pages: their text and their code; the tests run them, and whoever reads them may."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, ClassVar

from myst_parser.parsers.sphinx_ import MystParser

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx


class NotebookParser(MystParser):
    """Reads the cells of a notebook as one Markdown text."""

    supported: ClassVar[tuple[str, ...]] = ("notebook",)

    def parse(self, inputstring: str, document: nodes.document) -> None:
        """Parse the JSON of a notebook."""
        cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(inputstring)["cells"]]
        texts = [f"```python\n{text}\n```" if kind == "code" else text for kind, text in cells]
        super().parse("\n\n".join(texts), document)


def setup(app: Sphinx) -> None:
    """Register the parser."""
    app.add_source_suffix(".ipynb", "notebook")
    app.add_source_parser(NotebookParser)
