"""The laboratory's key, and what it signs: XAdES in the XML (signxml), PAdES in the PDF (pyHanko).

The folder of this bench's keys may hold `laboratory.key` and `laboratory.pem` (PEM; the certificate first, then those
that issued it). Those of simulated runs are signed by `simulated.pem`, key and certificate, which the bench makes.
"""

from __future__ import annotations

import io
import os
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base import InputError
from bench.record import keep_secret, keys_folder

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

LABORATORY, SIMULATED = "laboratory", "simulated.pem"
PASSWORD = "BENCH_SIGNING_PASSWORD"
"""Environment variable with the password of an encrypted key."""
SUBJECT = "Simulated laboratory (certifies nothing)"
_FIELD = "Laboratory"
_YEARS = 100


@dataclass(frozen=True)
class Signer:
    """A private key, and the certificates from the one of this key to the one that is trusted."""

    key: Any
    chain: tuple[Certificate, ...]

    @property
    def subject(self) -> str:
        """Whom the certificate names."""
        return self.chain[0].subject.rfc4514_string()

    def to_json(self) -> dict[str, str]:
        """What the certificate says about its signature."""
        return {"subject": self.subject, "certificate_sha256": fingerprint(self.chain[0])}

    def sign_xml(self, xml: bytes) -> bytes:
        """The XML with a XAdES signature (enveloped, the last element of the root)."""
        from lxml import etree
        from signxml.xades import XAdESSigner

        parser = etree.XMLParser(resolve_entities=False, no_network=True)
        signer = XAdESSigner(signature_algorithm=f"{_kind(self.key)}-sha256", digest_algorithm="sha256")
        signed = signer.sign(etree.fromstring(xml, parser), key=self.key, cert=list(self.chain))
        made: bytes = etree.tostring(signed, xml_declaration=True, encoding="UTF-8")
        return made

    def sign_pdf(self, pdf: bytes, reason: str) -> bytes:
        """The PDF with a PAdES signature that allows no change."""
        from asn1crypto import keys, x509
        from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
        from pyhanko.sign import fields, signers
        from pyhanko_certvalidator.registry import SimpleCertificateStore

        der = self.key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
        own, *others = (x509.Certificate.load(one.public_bytes(Encoding.DER)) for one in self.chain)
        signer = signers.SimpleSigner(
            signing_cert=own,
            signing_key=keys.PrivateKeyInfo.load(der),
            cert_registry=SimpleCertificateStore.from_certs([own, *others]),
        )
        how = signers.PdfSignatureMetadata(
            field_name=_FIELD,
            md_algorithm="sha256",
            subfilter=fields.SigSeedSubFilter.PADES,
            certify=True,
            docmdp_permissions=fields.MDPPerm.NO_CHANGES,
            reason=reason,
        )
        signed: bytes = signers.sign_pdf(_writer()(io.BytesIO(pdf)), how, signer=signer).getvalue()
        return signed


@cache
def _writer() -> type[Any]:
    """A writer that adds the signature only: version and metadata stay those of PDF/A-3, as typst wrote them."""
    from pyhanko.pdf_utils.incremental_writer import IncrementalPdfFileWriter

    class AsItIs(IncrementalPdfFileWriter):  # type: ignore[misc]
        def ensure_output_version(self, version: tuple[int, int]) -> None:
            pass

        def _update_meta(self) -> None:
            pass

    return AsItIs


def signer_of(key: Path | None, certificate: Path | None, simulated: bool) -> Signer | None:
    """The signer that is given, that of the laboratory, or of a simulated run; None where there is none.

    InputError where a file is wrong, or one of the two is missing.
    """
    if (key is None) != (certificate is None):
        raise InputError("--sign-key and --sign-certificate belong together; give both or neither")
    if key is not None and certificate is not None:
        return load_signer(key, certificate)
    with suppress(OSError, RuntimeError):
        if simulated:
            both = keys_folder() / SIMULATED
            if not both.exists():
                _make_simulated(both)
            return load_signer(both, both)
        stem = keys_folder() / LABORATORY
        if stem.with_suffix(".pem").exists():
            return load_signer(stem.with_suffix(".key"), stem.with_suffix(".pem"))
    return None


def load_signer(key: Path, certificate: Path) -> Signer:
    """Key and certificate from PEM files; InputError where they are wrong or do not belong together."""
    from cryptography.hazmat.primitives.serialization import load_pem_private_key
    from cryptography.x509 import load_pem_x509_certificates

    password = os.environ.get(PASSWORD)
    try:
        private = load_pem_private_key(content_of(key), None if password is None else password.encode())
    except (ValueError, TypeError) as error:
        todo = f"its password is read from {PASSWORD}"
        raise InputError(f"is no private key in PEM that can be read ({error}); {todo}", key) from None
    try:
        chain = tuple(load_pem_x509_certificates(content_of(certificate)))
    except ValueError as error:
        raise InputError(f"is no certificate in PEM ({error})", certificate) from None
    if _kind(private) == "":
        raise InputError("is neither an RSA nor an elliptic-curve key, which XAdES needs", key)
    if chain[0].public_key() != private.public_key():
        raise InputError(f"is not the certificate of the key {key}; the first one in the file must be", certificate)
    return Signer(private, chain)


def fingerprint(certificate: Certificate) -> str:
    """SHA-256 of a certificate, hexadecimal."""
    from cryptography.hazmat.primitives.hashes import SHA256

    return certificate.fingerprint(SHA256()).hex()


def _kind(key: Any) -> str:
    from cryptography.hazmat.primitives.asymmetric import ec, rsa

    return (
        "rsa" if isinstance(key, rsa.RSAPrivateKey) else "ecdsa" if isinstance(key, ec.EllipticCurvePrivateKey) else ""
    )


def content_of(path: Path) -> bytes:
    """Of a key or a certificate; InputError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path) from None


def _make_simulated(path: Path) -> None:
    """A key and a self-signed certificate of the simulated laboratory."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import rsa
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    key = rsa.generate_private_key(public_exponent=65537, key_size=3072)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, SUBJECT)])
    now = datetime.now(UTC).replace(microsecond=0)
    usage = x509.KeyUsage(True, True, False, False, False, False, False, False, False)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=3650))
        .not_valid_after(now + timedelta(days=365 * _YEARS))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, hashes.SHA256())
    )
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    keep_secret(path, secret + made.public_bytes(Encoding.PEM))
