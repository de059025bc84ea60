"""The certificate of a whole inertial unit: all parameters over temperature with their U, as facts and as DCC."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date
from typing import TYPE_CHECKING, Any

from bench.analysis import STANDARD_GRAVITY
from bench.base import __version__
from bench.deliver.certificate.certificate import FORMAT, STATEMENTS, Issue, amendment, number_of, people, traceability
from bench.deliver.certificate.dcc import DccDocument, dcc_xml
from bench.deliver.certificate.dsi import dsi
from bench.deliver.certificate.laboratory import Instrument, Laboratory
from bench.deliver.certificate.provenance import commit
from bench.record import ImuRecord, ImuVerificationRecord, shapes

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

_COVERAGE = {"coverage_factor": 2.0, "coverage_probability": 0.95}
_SI = {
    "deg/h/g": (1.0 / STANDARD_GRAVITY, r"\degree\hour\tothe{-1}\metre\tothe{-1}\second\tothe{2}", "deg/h/(m/s^2)"),
    "ug/g^2": (1e-6 / STANDARD_GRAVITY, r"\metre\tothe{-1}\second\tothe{2}", "1/(m/s^2)"),
}
"""Units that the D-SI cannot say: what turns a number into those of the XML, in D-SI and in words."""
_ERRORS = ("raw_rms", "rms", "mean", "scatter", "peak", "floor", "stated")


def imu_facts(
    record: ImuRecord,
    verified: ImuVerificationRecord | None,
    laboratory: Laboratory | None,
    instruments: tuple[Instrument, ...],
    issued: date,
    issue: Issue,
) -> dict[str, Any]:
    """All facts of the certificate; its number is computed from the others."""
    own = laboratory.item if laboratory else None
    content: dict[str, Any] = {
        "format": FORMAT,
        "title": "Calibration certificate",
        "draft": None if issue.draft is None else list(issue.draft),
        "amends": None if issue.amends is None else dict(issue.amends),
        "simulated": record.simulated,
        "issued": issued.isoformat(),
        "verdict": verified.verdict if verified else None,
        **people(laboratory),
        "item": {
            "serial": record.unit,
            "identity": None,
            "firmware": None,
            "coefficient_set": None,
            "model": own.model if own else "",
            "condition": own.condition if own else "",
            "received": own.received.isoformat() if own and own.received else None,
        },
        "calibrated": record.created,
        "verified": verified.created if verified else None,
        "validity": {"certified_degc": _certified(record, verified), "calibrated_degc": list(record.range_degc)},
        "method": _method(record),
        "conditions": [{"name": name, "value": value.replace("-", "−")} for name, value in _conditions(record)],
        "equipment": [tool.model_dump(mode="json") for tool in instruments],
        "traceability": traceability(instruments),
        "parameters": [_parameter(value) for value in record.content()["parameters"]],
        "verification": None if verified is None else _verification(verified),
        "conformity": verified.limits.content() if verified and verified.limits else None,
        "chain": {source.file: source.sha256 for source in (*record.sources, *(verified.sources if verified else ()))},
        "software": {"certificate": {"bench": __version__, "commit": commit()}, "run": dict(record.software)},
        "signer": None if issue.signer is None else dict(issue.signer),
        "statements": [*amendment(issue.amends), *STATEMENTS],
    }
    return {"number": number_of(content), **content}


def _method(record: ImuRecord) -> dict[str, Any]:
    plan = record.sources[-1]  # without a plan the attitudes stand in the run itself
    return {"plan": plan.file, "revision": plan.sha256, "orders": record.plan["orders"]}


def _certified(record: ImuRecord, verified: ImuVerificationRecord | None) -> list[float] | None:
    """The range of temperature that is certified: the one that was verified."""
    if verified is None:
        return None
    (low, high), (first, last) = record.range_degc, verified.range_degc
    return [max(low, first), min(high, last)]


def _parameter(value: Mapping[str, Any]) -> dict[str, Any]:
    known = {key: value[key] for key in ("name", "kind", "unit", "temperature_degc", "value")}
    known["expanded"] = value["U"]
    if value["unit"] in _SI:
        size, _, unit = _SI[value["unit"]]
        known["si"] = {"unit": unit, "value": size * value["value"], "expanded": size * value["U"]}
    return {**known, **_COVERAGE}


def _conditions(record: ImuRecord) -> Iterator[tuple[str, str]]:
    rates = sorted({position.rate_dps for position in record.positions})
    yield "Temperature of all axes", "{:.1f} to {:.1f} °C".format(*record.range_degc)
    yield "Attitudes", str(len({position.up for position in record.positions}))
    yield "Rates of the table", f"{', '.join(f'{rate:g}' for rate in rates)} deg/s"
    yield "Its scale", _reference(record.rate_ppm)
    yield "Latitude", f"{record.latitude_deg:g}°; the Earth's rate was taken off"
    yield "Gravity", f"{record.gravity:.6f} m/s², {_reference(record.gravity_ppm)}"
    yield "Means", f"{len(record.time_s)} of {record.interval_s:g} s"


def _reference(ppm: float) -> str:
    return f"standard uncertainty {ppm:g} ppm, in U" if ppm else "its uncertainty was not stated and is not in U"


def _verification(verified: ImuVerificationRecord) -> dict[str, Any]:
    stored = verified.content()
    return {key: stored[key] for key in ("verdict", "rows", "stays", "range_degc", "axes") if key in stored} | {
        "rule": verified.rule
    }


def imu_dcc(facts: Mapping[str, Any]) -> bytes:
    """The certificate as XML (DCC 3.2), not yet signed."""
    return dcc_xml(facts, _ImuDocument())


class _ImuDocument(DccDocument):
    """Elements of the DCC of an inertial unit."""

    ITEM = "Inertial unit"
    MEASURED = "Parameters over temperature"

    def _method(self, facts: Mapping[str, Any]) -> Element:
        method = facts["method"]
        orders = shapes(method["orders"])
        lines = (f"Tumble and rate table over temperature; plan {method['plan']}, SHA-256 {method['revision']}",
                 f"Orders of the curves over temperature: {orders}")  # fmt: skip
        return self.node("usedMethod", self.text("name", "Calibration of a triad of gyros and of accelerometers"),
                         self.text("description", *lines), self.node("norm", "JCGM 100:2008"))  # fmt: skip

    def _results(self, facts: Mapping[str, Any]) -> Iterator[Element]:
        by_name: dict[str, list[tuple[int, Mapping[str, Any]]]] = {}
        for i, one in enumerate(facts["parameters"]):
            by_name.setdefault(one["name"], []).append((i, one))
        for k, (name, rows) in enumerate(by_name.items()):
            lists = [self._at_temperature(i, one) for i, one in rows]
            made = self.node("list", self.text("name", name), *lists, id=f"parameter_{k}")
            yield self.node("result", self.text("name", name), self.node("data", made))
        verified = facts["verification"]
        if verified is not None:
            axes = [self._axis(i, axis) for i, axis in enumerate(verified["axes"])]
            made = self.node("list", self.text("name", "Errors of the outputs"), *axes, id="verification.axes")
            yield self.node("result", self.text("name", "Verification"), self.node("data", made))

    def _at_temperature(self, i: int, one: Mapping[str, Any]) -> Element:
        stated = one.get("si", one)
        unit = _SI[one["unit"]][1] if "si" in one else str(dsi(one["unit"]))
        inner = "si." if "si" in one else ""
        return self.node(
            "list",
            self.text("name", f"{one['name']} at {one['temperature_degc']:g} °C"),
            self._quantity(
                f"parameters.{i}.temperature_degc", "temperature", one["temperature_degc"], str(dsi("degC"))
            ),
            self._quantity(f"parameters.{i}.{inner}value", "value", stated["value"], unit, stated["expanded"]),
            id=f"parameters.{i}",
        )

    def _axis(self, i: int, axis: Mapping[str, Any]) -> Element:
        unit = str(dsi(axis["unit"]))
        own = (
            self._quantity(f"verification.axes.{i}.{key}", key.replace("_", " "), axis[key], unit) for key in _ERRORS
        )
        return self.node("list", self.text("name", axis["name"]), *own, id=f"verification.axes.{i}")

    def _quantity(self, path: str, name: str, value: float, unit: str, expanded: float | None = None) -> Element:
        known = [] if expanded is None else [
            self.si("expandedUnc", self.si("uncertainty", repr(expanded)),
                    self.si("coverageFactor", repr(_COVERAGE["coverage_factor"])),
                    self.si("coverageProbability", repr(_COVERAGE["coverage_probability"])))
        ]  # fmt: skip
        number = self.si("real", self.si("value", repr(value)), self.si("unit", unit), *known)
        return self.node("quantity", self.text("name", name), number, id=path)
