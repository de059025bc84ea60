"""Signatures of certificates: one digit changed anywhere is found, and so is a stranger's key."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse
from bench.deliver.certificate.signer import load_signer
from tests.support.commands import bench
from tests.support.dcc import faults, read_back
from tests.support.run_folders import make_run, ramp_run

pytest.importorskip("typst")
PROFILES = Path(__file__).parents[2] / "profiles"
PAPERS = ("--laboratory", PROFILES / "laboratory/simulated.yaml", "--equipment", PROFILES / "equipment/simulated.yaml")


def authority(folder, name="laboratory", kind="rsa"):
    """A certificate authority of the test, and a laboratory's key and certificate by it."""

    def key():
        return rsa.generate_private_key(65537, 2048) if kind == "rsa" else ec.generate_private_key(ec.SECP256R1())

    def issued(subject, own, issuer, by, ca):
        now = datetime.now(UTC)
        usage = x509.KeyUsage(not ca, not ca, False, False, False, ca, ca, False, False)
        return (
            x509.CertificateBuilder()
            .subject_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, subject)]))
            .issuer_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, issuer)]))
            .public_key(own.public_key()).serial_number(x509.random_serial_number())
            .not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=9))
            .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
            .add_extension(usage, critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(own.public_key()), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(by.public_key()), critical=False)
            .sign(by, hashes.SHA256())
        )  # fmt: skip

    root, own = key(), key()
    pem = serialization.Encoding.PEM
    secret = own.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    (folder / f"{name}.key").write_bytes(secret)
    (folder / f"{name}.pem").write_bytes(issued(name, own, "test authority", root, False).public_bytes(pem))
    (folder / f"{name}.ca").write_bytes(issued("test authority", root, "test authority", root, True).public_bytes(pem))
    return folder


@pytest.fixture(scope="module", params=["rsa", "ec"])
def issued(request, tmp_path_factory):
    """A folder with a signed certificate: `c.pdf`, `c.xml`, `c.json`."""
    folder = authority(tmp_path_factory.mktemp("signed"), kind=request.param)
    analyse(make_run(folder / "run", **ramp_run(loop_dph=0.0)), [load_model("spline")], diagnose=False)
    keys = ("--sign-key", folder / "laboratory.key", "--sign-certificate", folder / "laboratory.pem")
    done = bench("certificate", folder / "run", *PAPERS, *keys, "--out", folder / "c.pdf")
    assert done.exit_code == 0, done.output
    assert "signed by CN=laboratory" in done.stdout
    return folder


def verified(file, *options):
    done = bench("certificate", "--verify", file, "--json", *options)
    return done.exit_code, json.loads(done.stdout)


@pytest.mark.parametrize("name", ["c.pdf", "c.xml"])
def test_a_certificate_is_sound_for_whoever_trusts_the_authority(issued, name):
    code, said = verified(issued / name, "--trust", issued / "laboratory.ca")
    assert (code, said["sound"]) == (0, True), said
    assert said["number"] == json.loads((issued / "c.json").read_text())["number"]
    assert "laboratory" in said["parts"][0]["signer"]
    code, said = verified(issued / name)
    assert (code, said["sound"]) == (1, False)
    assert "not trusted here" in said["parts"][0]["fault"]


def test_the_signed_xml_is_valid_by_the_schema_and_read_by_a_second_reader(issued):
    xml = (issued / "c.xml").read_bytes()
    assert faults(xml) == []
    facts = json.loads((issued / "c.json").read_text())
    assert read_back(xml)["as_left.rms_dph"]["value"] == json.dumps(facts["as_left"]["rms_dph"])


def places(data, pattern):
    found = [match.start(1) for match in re.finditer(pattern, data, re.DOTALL)]
    assert found
    return found[:: max(1, len(found) // 6)]


def another_digit(data, at):
    return data[:at] + (b"1" if data[at : at + 1] != b"1" else b"2") + data[at + 1 :]


def test_one_digit_changed_in_the_xml_is_found(issued, tmp_path):
    data = (issued / "c.xml").read_bytes()
    for at in places(data, rb"<si:value>-?\d*\.?\d*(\d)"):
        (tmp_path / "c.xml").write_bytes(another_digit(data, at))
        code, said = verified(tmp_path / "c.xml", "--trust", issued / "laboratory.ca")
        assert code == 1
        assert "was altered after it was signed" in said["parts"][0]["fault"]


def test_a_changed_digit_anywhere_in_the_pdf_is_found(issued, tmp_path):
    data = (issued / "c.pdf").read_bytes()
    for at in range(2000, len(data), len(data) // 8):
        (tmp_path / "c.pdf").write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        code, said = verified(tmp_path / "c.pdf", "--trust", issued / "laboratory.ca")
        assert code == 1, at
        assert said["sound"] is False
    (tmp_path / "c.pdf").write_bytes(data + b"\n% more\n")
    assert verified(tmp_path / "c.pdf", "--trust", issued / "laboratory.ca")[0] == 1


@pytest.mark.parametrize("inside", ["certificate.xml", "certificate.json"])
def test_a_digit_changed_in_a_file_inside_the_pdf_is_found_even_under_a_new_signature(issued, tmp_path, inside):
    import typst  # the PDF is made again as a forger with a key would: one digit inside is another

    facts, xml = (issued / "c.json").read_bytes(), (issued / "c.xml").read_bytes()
    files = {"certificate.json": facts, "certificate.xml": xml}
    changed = {**files, inside: another_digit(files[inside], files[inside].index(b"0.0") + 2)}
    source = "".join(f'#pdf.attach("{name}", bytes(sys.inputs.at("{name}")))\n' for name in changed) + "text"
    texts = {name: data.decode() for name, data in changed.items()}
    paper = typst.Compiler(source.encode(), sys_inputs=texts).compile(format="pdf")
    signer = load_signer(issued / "laboratory.key", issued / "laboratory.pem")
    (tmp_path / "c.pdf").write_bytes(signer.sign_pdf(paper, "forged"))
    code, said = verified(tmp_path / "c.pdf", "--trust", issued / "laboratory.ca")
    assert code == 1
    pdf, in_xml, in_json = said["parts"]
    assert pdf["fault"] == ""
    assert (in_xml if inside.endswith("xml") else in_json)["fault"]


def test_a_strangers_signature_is_not_trusted(issued, tmp_path):
    authority(tmp_path, "stranger")
    signer = load_signer(tmp_path / "stranger.key", tmp_path / "stranger.pem")
    unsigned = re.sub(rb"<ds:Signature.*</ds:Signature>", b"", (issued / "c.xml").read_bytes(), flags=re.DOTALL)
    (tmp_path / "u.xml").write_bytes(unsigned)
    assert verified(tmp_path / "u.xml")[1]["parts"][0]["fault"] == "is not signed"
    (tmp_path / "s.xml").write_bytes(signer.sign_xml(unsigned.replace(b"Simulated laboratory", b"My own laboratory")))
    code, said = verified(tmp_path / "s.xml", "--trust", issued / "laboratory.ca")
    assert code == 1
    assert "CN=stranger" in said["parts"][0]["fault"]


def test_what_is_no_certificate_or_no_key_is_said_in_one_line(issued, tmp_path):
    (tmp_path / "x.txt").write_text("nothing")
    run, key, own = issued / "run", issued / "laboratory.key", issued / "laboratory.pem"
    for words, text in (
        (["--verify", tmp_path / "x.txt"], "is neither the PDF nor the XML of a certificate"),
        (["--verify", tmp_path / "none.pdf"], "cannot be read"),
        ([run, *PAPERS, "--sign-key", key], "belong together"),
        ([run, *PAPERS, "--sign-key", tmp_path / "x.txt", "--sign-certificate", own], "is no private"),
        ([run, *PAPERS, "--sign-key", key, "--sign-certificate", issued / "laboratory.ca"], "is not the"),
    ):  # fmt: skip
        done = bench("certificate", *words, "--out", tmp_path / "c.pdf")
        assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.output
        assert text in done.stderr
        assert not (tmp_path / "c.pdf").exists()


@pytest.mark.skipif(shutil.which("pdfsig") is None, reason="poppler is not installed")
def test_another_program_finds_the_signature_valid_over_the_whole_file(issued):
    said = subprocess.run(["pdfsig", "-nocert", issued / "c.pdf"], capture_output=True, text=True, check=False).stdout
    assert "Signature is Valid" in said
    assert "Total document signed" in said
    assert "ETSI.CAdES.detached" in said
    info = subprocess.run(["pdfinfo", issued / "c.pdf"], capture_output=True, text=True, check=True).stdout
    assert re.search(r"PDF version: +1\.7", info)
