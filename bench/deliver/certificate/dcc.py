"""The certificate for machines: PTB's digital calibration certificate 3.2 (XML) with units of the D-SI 2.1.

Every number of the results stands in it once, with the digits of certificate.json; its `id` is its path there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bench.base import in_print
from bench.deliver.certificate.dcc_numbers import Numbers

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

SCHEMA = "3.2.0"
DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
NO_COUNTRY = "ZZ"
"""User-assigned code of ISO 3166-1, where the laboratory file names no country."""

RESULTS = {
    "as_found": "As found",
    "as_left": "As left",
    "over_temperature": "Bias over temperature",
    "results": "Measured quantities",
    "uncertainty": "Uncertainty budget",
    "conformity": "Conformity with limits",
    "verification": "Verification",
    "validity": "Range of temperature",
    "thermometer": "Thermometer of the unit",
    "calibration": "Model and coefficients",
}
"""Parts of certificate.json that are results, and their names."""
_OF_MODEL = ("id", "coefficients", "parameters", "condition", "rows")
_CONFORMITY = {"PASS": "pass", "MARGINAL": "conditionalPass", "FAIL": "fail"}


def dcc_xml(facts: Mapping[str, Any], document: DccDocument | None = None) -> bytes:
    """The certificate as XML, not yet signed; `document` makes its parts, left out: that of a gyro."""
    from lxml import etree

    document = document or DccDocument()
    root = document.node("digitalCalibrationCertificate")
    root.set("schemaVersion", SCHEMA)
    root.append(document.administrative(facts))
    root.append(document.node("measurementResults", document.measured(facts)))
    made: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return made


class DccDocument:
    """Elements of the DCC of a gyro; texts are English."""

    ITEM = "Gyroscope"
    MEASURED = "Zero-rate output over temperature"

    def __init__(self) -> None:
        from lxml.builder import ElementMaker

        self.node = ElementMaker(namespace=DCC, nsmap={"dcc": DCC, "si": SI})
        self.si = ElementMaker(namespace=SI, nsmap={"dcc": DCC, "si": SI})

    def text(self, tag: str, *lines: str) -> Element:
        """A localised text; a rich one has the same form."""
        return self.node(tag, *(self.node("content", line, lang="en") for line in lines))

    # -- administrative data ----------------------------------------------------------------------------------------

    def administrative(self, facts: Mapping[str, Any]) -> Element:
        """Everything but the results."""
        return self.node(
            "administrativeData",
            self._software("dccSoftware", {"bench": facts["software"]["certificate"]["bench"]}),
            self._core(facts),
            self._items(facts["item"]),
            self.node("calibrationLaboratory", self._contact("contact", facts["laboratory"])),
            self._persons(facts["authorised_by"]),
            self._contact("customer", facts["customer"]),
            self._statements(facts),
        )

    def _software(self, tag: str, releases: Mapping[str, str]) -> Element:
        known = (self.node("software", self.text("name", name), self.node("release", str(release)))
                 for name, release in releases.items())  # fmt: skip
        return self.node(tag, *known)

    def _core(self, facts: Mapping[str, Any]) -> Element:
        laboratory, node = facts["laboratory"] or {}, self.node
        received, amends = facts["item"]["received"], facts.get("amends")
        return node(
            "coreData",
            node("countryCodeISO3166_1", laboratory.get("country") or NO_COUNTRY),
            node("usedLangCodeISO639_1", "en"),
            node("mandatoryLangCodeISO639_1", "en"),
            node("uniqueIdentifier", facts["number"]),
            *([node("receiptDate", received)] if received else []),
            node("beginPerformanceDate", facts["calibrated"][:10]),
            node("endPerformanceDate", (facts["verified"] or facts["calibrated"])[:10]),
            node("performanceLocation", "laboratory"),
            node("issueDate", facts["issued"]),
            *([self._previous(amends)] if amends else []),
        )

    def _previous(self, amends: Mapping[str, Any]) -> Element:
        return self.node(
            "previousReport",
            self.text(
                "referral", f"Amendment to certificate {amends['number']}, which it replaces: {amends['reason']}"
            ),
            self.node("referralID", amends["number"]),
            self.node("procedure", "SHA-256 of certificate.json"),
            self.node("value", amends["sha256"]),
        )

    def _items(self, item: Mapping[str, Any]) -> Element:
        known = [(item["serial"], "serial number", "manufacturer"), (item["identity"], "identity", "manufacturer")]
        identifications = (
            self.node(
                "identification", self.node("issuer", issuer), self.node("value", str(value)), self.text("name", name)
            )
            for value, name, issuer in known
            if value is not None
        )
        noted = {"condition": "condition on receipt", "firmware": "firmware", "coefficient_set": "coefficient set"}
        notes = [f"{name}: {item[key]}" for key, name in noted.items() if item[key] not in (None, "")]
        made = self.node(
            "item",
            self.text("name", f"{self.ITEM} {item['serial']}"),
            *([self.text("description", *notes)] if notes else []),
            self.node("manufacturer", self.text("name", "see model" if item["model"] else "not stated")),
            *([self.node("model", _token(item["model"]))] if item["model"] else []),
            self.node("identifications", *identifications),
        )
        return self.node("items", made)

    def _contact(self, tag: str, party: Mapping[str, Any] | None) -> Element:
        name, address = (party or {}).get("name") or "not stated", (party or {}).get("address") or "not stated"
        country = (party or {}).get("country")
        code = [self.node("countryCode", country)] if country else []
        return self.node(tag, self.text("name", name), self.node("location", *code, self.text("further", address)))

    def _persons(self, signs: Mapping[str, Any] | None) -> Element:
        name, function = (signs or {}).get("name") or "not stated", (signs or {}).get("function")
        role = [self.node("role", _token(function))] if function else []
        person = self.node("person", self.text("name", name))
        return self.node("respPersons", self.node("respPerson", person, *role, self.node("mainSigner", "true")))

    def _statements(self, facts: Mapping[str, Any]) -> Element:
        texts = [*facts["statements"], facts["traceability"], *facts["remarks"]]
        if facts["simulated"]:
            texts.insert(0, "Simulated unit and station: shows the form of a certificate and certifies nothing.")
        if facts["draft"] is not None:
            texts.insert(0, f"DRAFT: {'; '.join(facts['draft'])}")
        made = [self.node("statement", self.text("declaration", text)) for text in texts]
        if facts["conformity"] is not None and facts["verdict"] in _CONFORMITY:
            made.append(self.node(
                "statement",
                self.text("name", f"Conformity with the limits “{facts['conformity']['name']}”: {facts['verdict']}"),
                self.text("declaration", facts["conformity"]["decision_rule"]),
                self.node("conformity", _CONFORMITY[facts["verdict"]]),
            ))  # fmt: skip
        return self.node("statements", *made)

    # -- results ----------------------------------------------------------------------------------------------------

    def measured(self, facts: Mapping[str, Any]) -> Element:
        """Method, equipment, conditions and all numbers."""
        return self.node(
            "measurementResult",
            self.text("name", self.MEASURED),
            self.node("usedMethods", self._method(facts)),
            *([self._software("usedSoftware", facts["software"]["run"])] if facts["software"]["run"] else []),
            *self._equipment(facts["equipment"]),
            self._conditions(facts["conditions"]),
            self.node("results", *self._results(facts)),
        )

    def _method(self, facts: Mapping[str, Any]) -> Element:
        method = facts["method"]
        deviations = "; ".join(method["deviations"]) or "none"
        lines = [f"Temperature profile {method['profile']}, SHA-256 {method['revision']}", f"Deviations: {deviations}"]
        if method["verification_profile"]:
            lines.insert(1, f"Verification: {method['verification_profile']}, {method['verification_revision']}")
        description = self.text("description", *lines)
        return self.node("usedMethod", self.text("name", "Calibration over temperature"), description,
                         self.node("norm", "JCGM 100:2008"))  # fmt: skip

    def _equipment(self, tools: Sequence[Mapping[str, Any]]) -> list[Element]:
        made = []
        for tool in tools:
            notes = [f"{key} {tool[key]}" for key in ("certificate", "calibrated", "due") if tool[key]]
            issuer, serial = self.node("issuer", "manufacturer"), self.node("value", _token(tool["serial"]))
            identification = self.node("identification", issuer, serial, self.text("name", "serial number"))
            made.append(self.node(
                "measuringEquipment",
                self.text("name", tool["name"]),
                *([self.text("description", *notes)] if notes else []),
                *([self.node("model", _token(tool["model"]))] if tool["model"] else []),
                self.node("identifications", identification),
            ))  # fmt: skip
        return [self.node("measuringEquipments", *made)] if made else []

    def _conditions(self, conditions: Sequence[Mapping[str, str]]) -> Element:
        made = (
            self.node(
                "influenceCondition", self.text("name", one["name"]), self.node("data", self.text("text", one["value"]))
            )
            for one in conditions
        )
        return self.node("influenceConditions", *made)

    def _results(self, facts: Mapping[str, Any]) -> Iterator[Element]:
        numbers = Numbers(self.node, self.si, facts)
        for key, name in RESULTS.items():
            content = facts[key]
            if key == "calibration":
                content = {part: content[part] for part in _OF_MODEL}
            if content and (found := numbers.listed(key, key, content)) is not None:
                yield self.node("result", self.text("name", name), self.node("data", found))


def _token(text: str) -> str:
    """A text without spaces at its ends and in print, as the schema wants it."""
    return " ".join(in_print(str(text)).split()) or "–"
