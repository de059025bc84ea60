"""Whether a certificate is as it was signed: its XML, its PDF, and what is inside the PDF."""

from __future__ import annotations

import asyncio
import io
import json
import logging
from base64 import b64decode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base import InputError
from bench.deliver.certificate.certificate import number_of
from bench.deliver.certificate.dcc import DCC, SI
from bench.deliver.certificate.signer import LABORATORY, SIMULATED, content_of, fingerprint
from bench.record import keys_folder

if TYPE_CHECKING:
    from cryptography.x509 import Certificate


@dataclass(frozen=True)
class Part:
    """One thing that was looked at: what is wrong with it (empty: nothing), and who signed it."""

    what: str
    fault: str
    signer: str = ""


@dataclass(frozen=True)
class CheckedCertificate:
    """All of a file; `number` is what it says to be."""

    file: Path
    number: str | None
    parts: tuple[Part, ...]

    @property
    def sound(self) -> bool:
        """Nothing is wrong with any part."""
        return all(not part.fault for part in self.parts)


def check_certificate(file: Path, trust: Sequence[Path] = ()) -> CheckedCertificate:
    """Look at a certificate, PDF or XML; InputError where it cannot be read or is neither.

    Trusted are the certificates in `trust`, and those of the laboratory and of simulated runs beside the keys.
    """
    for name in ("pyhanko", "pyhanko_certvalidator"):  # what they log is in the answer
        logging.getLogger(name).setLevel(logging.CRITICAL)
    data = content_of(file)
    anchors = tuple(_anchors(trust))
    if data.lstrip()[:5] == b"%PDF-":
        return CheckedCertificate(file, *_pdf(data, anchors))
    if b"<" in data[:200]:
        part, number, _ = _xml("XML", data, anchors)
        return CheckedCertificate(file, number, (part,))
    raise InputError("is neither the PDF nor the XML of a certificate", file)


def _anchors(trust: Sequence[Path]) -> Iterator[Certificate]:
    from cryptography.x509 import load_pem_x509_certificates

    own = [keys_folder() / name for name in (f"{LABORATORY}.pem", SIMULATED)]
    for path in (*trust, *(path for path in own if path.is_file())):
        try:
            yield from load_pem_x509_certificates(content_of(path))
        except ValueError as error:
            raise InputError(f"is no certificate in PEM ({error})", path) from None


def _trusted(chain: Sequence[Certificate], anchors: Sequence[Certificate]) -> str:
    """Why the first certificate of a chain is not trusted; empty where it is."""
    from asn1crypto import x509
    from cryptography.hazmat.primitives.serialization import Encoding
    from pyhanko_certvalidator import CertificateValidator
    from pyhanko_certvalidator.errors import PathError, ValidationError

    own, *others = (x509.Certificate.load(one.public_bytes(Encoding.DER)) for one in chain)
    try:
        validator = CertificateValidator(own, others, validation_context=_context(anchors))
        asyncio.run(validator.async_validate_usage({"digital_signature"}))
    except (PathError, ValidationError) as error:
        key = f"{fingerprint(chain[0])[:16]}…"
        return f"is signed by {chain[0].subject.rfc4514_string()} ({key}), which is not trusted here: {error}"
    return ""


def _context(anchors: Sequence[Certificate]) -> Any:
    from asn1crypto import x509
    from cryptography.hazmat.primitives.serialization import Encoding
    from pyhanko_certvalidator import ValidationContext

    roots = [x509.Certificate.load(one.public_bytes(Encoding.DER)) for one in anchors]
    return ValidationContext(trust_roots=roots, allow_fetching=False)


def _xml(what: str, data: bytes, anchors: Sequence[Certificate]) -> tuple[Part, str | None, Any]:
    """The verdict on the XML, its number, and what of it is signed."""
    from cryptography.x509 import load_der_x509_certificate
    from lxml import etree
    from signxml.exceptions import SignXMLException
    from signxml.xades import XAdESSignatureConfiguration, XAdESVerifier

    try:
        root = etree.fromstring(data, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        return Part(what, f"is damaged: {error}"), None, None
    number = root.findtext(f".//{{{DCC}}}uniqueIdentifier")
    texts = root.findall("{*}Signature/{*}KeyInfo/{*}X509Data/{*}X509Certificate")
    if root.tag != f"{{{DCC}}}digitalCalibrationCertificate":
        return Part(what, "is not a digital calibration certificate"), None, None
    if not texts:
        return Part(what, "is not signed"), number, root
    try:
        chain = [load_der_x509_certificate(b64decode(one.text)) for one in texts]
        config = XAdESSignatureConfiguration(location="./")
        count = len(root.findall("{*}Signature/{*}SignedInfo/{*}Reference"))
        found = XAdESVerifier().verify(data, x509_cert=chain[0], expect_references=count, expect_config=config)
        signed = [one.signed_xml for one in found if one.signed_xml is not None and one.signed_xml.tag == root.tag]
    except (SignXMLException, ValueError, TypeError) as error:
        return Part(what, f"was altered after it was signed: {error}"), number, None
    if len(signed) != 1:
        return Part(what, "has a signature that does not cover it"), number, None
    number = signed[0].findtext(f".//{{{DCC}}}uniqueIdentifier")
    return Part(what, _trusted(chain, anchors), chain[0].subject.rfc4514_string()), number, signed[0]


def _pdf(data: bytes, anchors: Sequence[Certificate]) -> tuple[str | None, tuple[Part, ...]]:
    from pyhanko.pdf_utils.misc import PdfError
    from pyhanko.pdf_utils.reader import PdfFileReader

    try:
        reader = PdfFileReader(io.BytesIO(data))
        parts = [_signed_pdf(reader, anchors)]
        inside = _attachments(reader)
    except (PdfError, ValueError, TypeError, KeyError, IndexError, OSError) as error:
        return None, (Part("PDF", f"is damaged: {error}"),)
    if "certificate.xml" not in inside or "certificate.json" not in inside:
        return None, (*parts, Part("XML in the PDF", "is missing"))
    part, number, signed = _xml("XML in the PDF", inside["certificate.xml"], anchors)
    fault = (
        "cannot be compared: the XML is not sound" if signed is None else _differs(inside["certificate.json"], signed)
    )
    return number, (*parts, part, Part("JSON in the PDF", fault))


def _signed_pdf(reader: Any, anchors: Sequence[Certificate]) -> Part:
    from pyhanko.sign.validation import validate_pdf_signature
    from pyhanko.sign.validation.status import SignatureCoverageLevel

    signatures = reader.embedded_regular_signatures
    if len(signatures) != 1:
        return Part("PDF", "is not signed" if not signatures else "has several signatures, the bench makes one")
    status = validate_pdf_signature(signatures[0], _context(anchors))
    signer = status.signing_cert.subject.human_friendly
    if not (status.intact and status.valid and status.docmdp_ok):
        return Part("PDF", "was altered after it was signed", signer)
    if status.coverage != SignatureCoverageLevel.ENTIRE_FILE:
        return Part("PDF", "was added to after it was signed", signer)
    if not status.trusted:
        return Part(
            "PDF",
            f"is signed by {signer} ({status.signing_cert.sha256.hex()[:16]}…), which is not trusted here",
            signer,
        )
    return Part("PDF", "" if status.bottom_line else "has a signature that is not valid", signer)


def _attachments(reader: Any) -> dict[str, bytes]:
    """Files inside a PDF, by name."""
    names = reader.root["/Names"]["/EmbeddedFiles"]["/Names"]
    entries = [names[i] for i in range(1, len(names), 2)]
    return {str(entry["/UF"]): bytes(entry["/EF"]["/F"].data) for entry in entries}


def _differs(text: bytes, signed: Any) -> str:
    """How certificate.json differs from the XML; empty where every number is the same."""
    try:
        facts = json.loads(text)
        said = signed.findtext(f".//{{{DCC}}}uniqueIdentifier")
        if facts["number"] != number_of(facts) or facts["number"] != said:
            return f"is not what its number {facts['number']} was made of"
        for quantity in signed.iter(f"{{{DCC}}}quantity"):
            path, value = quantity.get("id"), quantity.findtext(f"{{{SI}}}real/{{{SI}}}value")
            if json.dumps(_at(facts, path.split("."))) != value:
                return f"differs from the XML at {path}: {value} there"
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        return f"is damaged: {error}"
    return ""


def _at(content: Any, steps: Sequence[str]) -> Any:
    """The value at a path; a step of the path may itself contain points or stand for another character."""
    for step in steps:
        content = content[int(step)] if isinstance(content, list) else content[step]
    return content
