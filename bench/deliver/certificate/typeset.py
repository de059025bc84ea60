"""PDF of a certificate: facts and figures into the typst template. The same facts give the same bytes.

The fonts are those inside typst, which lack Chinese: only a certificate with such words is set with fonts of the
system, too. Nothing is fetched from a network. The facts are attached as certificate.json (PDF/A-3, as typst claims).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, date, datetime
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

from bench.base import BenchError, InputError

_TEMPLATES = files("bench.deliver.certificate")


def require_typst() -> None:
    """InputError where what a certificate is made with is not installed."""
    if missing := [name for name in ("typst", "lxml", "signxml", "pyhanko") if find_spec(name) is None]:
        raise InputError(f"a certificate needs {', '.join(missing)}: pip install 'gyro-thermal-bench[certificate]'")


def facts_text(facts: Mapping[str, Any]) -> str:
    """certificate.json."""
    return json.dumps(facts, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def typeset_pdf(
    facts: Mapping[str, Any], figures: Mapping[str, Any], dcc: bytes, issued: date, body: str = "certificate"
) -> bytes:
    """The certificate as PDF, with its facts and its XML inside; `body` names the template of its pages."""
    require_typst()
    import typst

    inputs = {"facts": facts_text(facts), "figures": json.dumps(figures, allow_nan=False), "dcc": dcc.decode()}
    template = b"".join((_TEMPLATES / f"{name}.typ").read_bytes() for name in ("style", body))
    at = datetime(issued.year, issued.month, issued.day, tzinfo=UTC)
    made = None
    for own_fonts in (True, False):
        compiler = typst.Compiler(template, ignore_system_fonts=own_fonts, sys_inputs=inputs)
        try:
            made = compiler.compile(format="pdf", pdf_standards=["a-3a", "ua-1"], timestamp=int(at.timestamp()))
            break
        except typst.TypstError as error:
            lacks = "could not be displayed with font" in str(error)
            if not (own_fonts and lacks):
                hint = "; install a font that has it, for Chinese fonts-noto-cjk" if lacks else ""
                raise BenchError(f"the certificate cannot be typeset: {error}{hint}") from error
    if not isinstance(made, bytes):
        raise BenchError("the certificate cannot be typeset: no page was made")
    return made
