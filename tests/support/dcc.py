"""The schemas of the digital calibration certificate, and pydcc as a second reader."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import pytest

SCHEMAS = Path(os.environ.get("BENCH_DCC_SCHEMAS") or Path(__file__).parents[2] / ".." / "shared" / "reference" / "dcc")


def schema() -> Any:
    """PTB's schema; the test is skipped where it is absent."""
    from lxml import etree

    if not (SCHEMAS / "dcc.xsd").is_file():
        pytest.skip(f"the schemas of the DCC are not in {SCHEMAS}: set BENCH_DCC_SCHEMAS")

    class Here(etree.Resolver):
        def resolve(self, url, pubid, context):
            return self.resolve_filename(str(SCHEMAS / url.rpartition("/")[2]), context)

    parser = etree.XMLParser(no_network=True)
    parser.resolvers.add(Here())
    return etree.XMLSchema(etree.parse(str(SCHEMAS / "dcc.xsd"), parser))


def faults(xml: bytes) -> list[str]:
    """What of the XML the schema refuses."""
    from lxml import etree

    known = schema()
    known.validate(etree.fromstring(xml))
    return [str(error) for error in known.error_log]


def _pydcc() -> Any:
    """pydcc without what it needs for signatures and schemas only.

    Its oscrypto does not know versions of OpenSSL above 3.0.9, and its validator asks www.ptb.de for schemas.
    """
    with patch.dict(sys.modules):
        stub = ModuleType("certvalidator")
        stub.CertificateValidator = stub.errors = stub.ValidationContext = None
        sys.modules["certvalidator"] = stub
        from dcc import dcc as reader
    reader.DCCXMLValidator = lambda: None
    return reader


def read_back(xml: bytes) -> dict[str, dict[str, str]]:
    """Every quantity as pydcc reads it, by its id: value, unit and uncertainty as text."""
    reader = _pydcc()
    document = reader.DCC(byte_array=xml, signature_verification=False)
    found = {}
    for path, quantity in document.get_calibration_results("xpath"):
        (content,) = quantity.values()
        found[re.findall(r"@ id ='([^']*)'", path)[-1]] = {
            name.rpartition("}")[2]: value for name, value in content.items()
        }
    return found
