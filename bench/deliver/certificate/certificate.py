"""The facts of a calibration certificate as one JSON object, which the PDF shows and carries as an attachment.

The fields follow ISO/IEC 17025 clause 7.8 as secondary sources describe it; conformity to it is not claimed. Terms
are those of IEEE 528, 952 and 1431.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any

import numpy as np

from bench.analysis import MEANING, OF_DATA, Change, State, turning
from bench.base import FloatArray, __version__, finite
from bench.deliver.certificate.budget import Uncertainty, compared_thermometers
from bench.deliver.certificate.evidence import LEAST_COVERED, Evidence
from bench.deliver.certificate.laboratory import Instrument, Laboratory
from bench.deliver.certificate.propagation import PERCENT
from bench.deliver.certificate.provenance import commit
from bench.record import MANIFEST, Dataset, Manifest, earth_told, sha256

FORMAT = 1
_STEP_DEGC = 12.5
STATEMENTS = (
    "The results relate only to the item calibrated, in the condition in which it was calibrated.",
    "This certificate shall not be reproduced except in full without the written approval of the laboratory.",
    "Its fields are modelled on ISO/IEC 17025, clause 7.8; conformity to that standard is not claimed.",
)


@dataclass(frozen=True)
class Issue:
    """How a certificate is issued."""

    draft: Sequence[str] | None = None
    """What it lacks; None: it is not a draft."""
    signer: Mapping[str, str] | None = None
    amends: Mapping[str, Any] | None = None
    """The certificate that it replaces, and why."""


def facts(
    evidence: Evidence, laboratory: Laboratory | None, budget: Uncertainty, issued: date, issue: Issue = Issue()
) -> dict[str, Any]:
    """All facts of the certificate; its number is computed from the others."""
    judgement, verdict = evidence.judgement, evidence.verdict
    known, change = evidence.manifest, _change(evidence)
    content: dict[str, Any] = {
        "format": FORMAT,
        "title": "Calibration certificate",
        "draft": None if issue.draft is None else list(issue.draft),
        "amends": None if issue.amends is None else dict(issue.amends),
        "simulated": bool(known.simulated),
        "issued": issued.isoformat(),
        "verdict": verdict,
        **people(laboratory),
        "item": _item(known, laboratory),
        "calibrated": known.created,
        "verified": evidence.verification.manifest.created if evidence.verification else None,
        "verification": _verification(evidence),
        "validity": _validity(evidence),
        "method": _method(evidence),
        "conditions": _conditions(evidence),
        "equipment": [tool.model_dump(mode="json") for tool in evidence.instruments],
        "traceability": traceability(evidence.instruments),
        "as_found": _as_found(evidence, change),
        "as_left": _as_left(evidence, change, budget),
        "over_temperature": _over_temperature(evidence),
        "thermometer": compared_thermometers(evidence.source.dataset),
        "results": [q.to_json() for q in evidence.quantities() if q.name in MEANING and q.name not in OF_DATA],
        "uncertainty": budget.to_json(),
        "conformity": {**judgement.to_json(), "verdict": verdict} if judgement else None,
        "calibration": _calibration(evidence),
        "chain": _chain(evidence),
        "data": {
            "calibration": evidence.done.counts(),
            "verification": evidence.verification.done.counts() if evidence.verification else None,
        },
        "software": _software(evidence),
        "signer": None if issue.signer is None else dict(issue.signer),
        "statements": [*amendment(issue.amends), *STATEMENTS],
    }
    return {"number": number_of(content), **content}


def amendment(amends: Mapping[str, Any] | None) -> list[str]:
    """The statement that ISO/IEC 17025, 7.8.8.2 and 7.8.8.3, ask for."""
    if amends is None:
        return []
    return [
        f"Amendment to certificate {amends['number']} of {amends['issued']}, which it replaces: {amends['reason']}."
    ]


def number_of(content: Mapping[str, Any]) -> str:
    """Unit, day of issue and the first digits of the SHA-256 of all facts: the same facts, the same number."""
    text = json.dumps({key: value for key, value in content.items() if key != "number"}, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:8].upper()
    draft = "DRAFT-" if content.get("draft") else ""
    return f"{draft}{content['item']['serial']}-{str(content['issued']).replace('-', '')}-{digest}"


def people(laboratory: Laboratory | None) -> dict[str, Any]:
    """Laboratory, customer and signatory, as far as they are stated."""
    if laboratory is None:
        return {
            "laboratory": None, "place": "", "customer": None, "authorised_by": None, "operator": None, "remarks": [],
            "recommended_interval": "",
        }  # fmt: skip
    signs = laboratory.authorised_by
    return {
        "laboratory": laboratory.laboratory.model_dump(),
        "place": laboratory.place or laboratory.laboratory.address,
        "customer": laboratory.customer.model_dump() if laboratory.customer else None,
        "authorised_by": signs.model_dump() if signs else None,
        "operator": signs.name if signs else None,
        "remarks": list(laboratory.remarks),
        "recommended_interval": laboratory.recommended_interval,
    }


def _item(manifest: Manifest, laboratory: Laboratory | None) -> dict[str, Any]:
    identity = manifest.unit_identity
    own = laboratory.item if laboratory else None
    return {
        "serial": manifest.unit,
        "identity": identity.serial if identity else None,
        "firmware": identity.firmware if identity else None,
        "coefficient_set": identity.coefficient_set if identity else None,
        "layout": manifest.gyro.layout if manifest.gyro else None,
        "model": own.model if own else "",
        "condition": own.condition if own else "",
        "received": own.received.isoformat() if own and own.received else None,
    }


def _method(evidence: Evidence) -> dict[str, Any]:
    deviations = [
        f"segment '{s.name}': {s.reason or s.outcome}"
        for s in evidence.manifest.segments
        if s.outcome not in {"done", "detected"}
    ]
    theirs = evidence.verification.manifest if evidence.verification else None
    return {
        "profile": evidence.manifest.profile,
        "revision": evidence.manifest.files.get("profile.yaml"),
        "deviations": deviations,
        "averaging_s": evidence.source.dataset.interval_s,
        "verification_profile": theirs.profile if theirs else None,
        "verification_revision": theirs.files.get("profile.yaml") if theirs else None,
    }


def _verification(evidence: Evidence) -> dict[str, Any] | None:
    """The verdict of the verification, and the share of the calibration's range that it covers."""
    if evidence.verification is None:
        return None
    covered, verdict = evidence.verification.covered, evidence.verification.verdict
    return {
        "verdict": verdict,
        "covered_percent": 100.0 * covered.share,
        "covered_degc": list(covered.verified_degc),
        "validity_degc": list(covered.valid_degc),
        "least_percent": 100.0 * LEAST_COVERED,
    }


def traceability(instruments: Sequence[Instrument]) -> str:
    """The statement of ISO/IEC 17025, 7.8.4.1 c."""
    if not instruments:
        return "No reference equipment was stated: the results are not metrologically traceable."
    without = [f"{tool.name} {tool.serial}" for tool in instruments if not tool.certificate.strip()]
    if without:
        return f"Metrological traceability is not shown: no certificate is stated of {', '.join(without)}."
    return "The results are metrologically traceable through the calibrations of this equipment by its certificates."


def _validity(evidence: Evidence) -> dict[str, Any]:
    """The range in temperature that is certified, which is the one that was verified, and the one that was fitted."""
    stored = evidence.stored.content()["calibration"]["validity"]
    fitted = stored.get("temperature")
    if evidence.verification is None or fitted is None:
        return {"certified_degc": None, "fitted": stored}
    low, high = evidence.verification.covered.verified_degc
    return {"certified_degc": [max(low, fitted["from"]), min(high, fitted["to"])], "fitted": stored}


_SURROUNDINGS = (
    ("chamber_temperature", "Air in the chamber", "°C"),
    ("reference_temperature", "Reference thermometer", "°C"),
    ("humidity", "Relative humidity", "%"),
    ("pressure", "Pressure of the air", "hPa"),
    ("supply", "Supply voltage", "V"),
)


def _conditions(evidence: Evidence) -> list[dict[str, str]]:
    data = evidence.source.dataset
    rows = [("Temperature of the unit", *_range(data.channel("temperature")), "°C")]
    slope = data.dT_dt[np.isfinite(data.dT_dt)]
    rows.append(("Rate of change of temperature", *_range(slope), "°C/min"))
    for name, words, unit in _SURROUNDINGS:
        if np.any(np.isfinite(data.channels.get(name, np.array([np.nan])))):
            rows.append((words, *_range(data.channels[name]), unit))
    texts = {name: f"{low:.4g} to {high:.4g} {unit}" for name, low, high, unit in rows}
    shown = [{"name": name, "value": text.replace("-", "−")} for name, text in texts.items()]
    turned = "compensated by the encoder of the rate table" if "applied_rate" in data.channels else "unit at rest"
    runs = [("calibration run", evidence.done), *(("verification run", one.done) for one in evidence.verifications)]
    return [
        *shown,
        *({"name": f"Data of the {role}", "value": done.counted} for role, done in runs),
        {"name": "Applied rate", "value": turned},
        {"name": "Earth rate", "value": earth_told(evidence.manifest.orientation).removeprefix("Earth rate: ")},
    ]


def _range(values: FloatArray) -> tuple[float, float]:
    return float(np.nanmin(values)), float(np.nanmax(values))


def _as_found(evidence: Evidence, change: Change) -> dict[str, Any]:
    identity = evidence.manifest.unit_identity
    state = identity.coefficient_set if identity else None
    what = f"output with coefficient set {state} in force" if state else "output without correction"
    return {**_state(change.before), "what": what, "within_degc": list(change.within_degc)}


def _as_left(evidence: Evidence, change: Change, budget: Uncertainty) -> dict[str, Any]:
    verification = evidence.verification
    k = budget.at_rest.coverage_factor
    expanded = {"expanded_dph": budget.expanded_dph, "coverage_factor": k, "coverage_probability": PERCENT / 100.0}
    if verification is None:
        known = {quantity.name: quantity.value for quantity in evidence.quantities()}
        what = "calculated: error on data held out of the fit; not yet verified in the unit"
        figures = {**_state(None), "rms_dph": known["residual_rms_dph"], "peak_dph": finite(known["residual_peak_dph"])}
        return {**figures, **expanded, "what": what, "verified": False, "within_degc": list(change.within_degc)}
    what = (
        "output as the unit corrects it, measured in an independent run"
        if verification.in_unit
        else "calibration applied to an independent run of the uncorrected output"
    )
    low, high = change.within_degc
    what = f"{what}, {low:.0f} to {high:.0f} °C".replace("-", "−")
    factors = {"factor": finite(change.factor), "turning_factor": finite(change.turning_factor)}
    left = {**_state(change.after), **factors, **expanded, "what": what, "verified": verification.in_unit}
    return {**left, "within_degc": list(change.within_degc)}


def _change(evidence: Evidence) -> Change:
    """From the output as found to the output as left, over the temperatures that both records have."""
    found = evidence.source.dataset
    if evidence.verification is None:
        return Change.between(found, found, found.bias - evidence.source.fit.predict(found).bias)
    return Change.between(found, evidence.verification.data, evidence.verification.left)


def _state(state: State | None) -> dict[str, Any]:
    """Figures at rest [deg/h], about zero, and under rotation where a table turned the unit."""
    rest, turned = (None, None) if state is None else (state.rest, state.turning)
    names = ("rms", "mean", "scatter", "span", "peak")
    figures = {f"{name}_dph": getattr(rest, f"{name}_dph", None) for name in names}
    return {**figures, "turning": None if turned is None else turned.to_json()}


def _over_temperature(evidence: Evidence) -> list[dict[str, Any]]:
    """Bias at rest by temperature, heating and cooling, as found and as left: means over bins of 12.5 degC."""
    found = evidence.source.dataset
    left = found.bias - evidence.source.fit.predict(found).bias
    after = (found, left) if evidence.verification is None else (evidence.verification.data, evidence.verification.left)
    temperature = found.channel("temperature")
    first, last = (round(end / _STEP_DEGC) for end in _range(temperature))
    rows = []
    for step in range(first, last + 1):
        row: dict[str, Any] = {"temperature_degc": step * _STEP_DEGC}
        for key, data, values in (("found", found, found.bias), ("left", *after)):
            for sign, branch in ((1, "heating"), (-1, "cooling")):
                row[f"{key}_{branch}_dph"] = _mean(data, values, step * _STEP_DEGC, sign)
        rows.append(row)
    return rows


def _mean(data: Dataset, values: FloatArray, at_degc: float, sign: int) -> float | None:
    near = np.abs(data.channel("temperature") - at_degc) <= _STEP_DEGC / 4
    chosen = values[near & ~turning(data) & (data.direction == sign) & np.isfinite(values)]
    return float(chosen.mean()) if chosen.size else None


def _calibration(evidence: Evidence) -> dict[str, Any]:
    stored = evidence.stored.content()
    content = stored["calibration"]
    return {
        "id": evidence.calibration_id,
        "verdict": stored["verdict"],
        "model": content["model"],
        "coefficients": content["coefficients"],
        "parameters": content["parameters"],
        "validity": content["validity"],
        "condition": content["condition"],
        "rows": content["rows"],
        "covariance": "calibration.json, calibration.scaled.covariance",
        "flashed": evidence.flashed.content() if evidence.flashed else None,
    }


def _chain(evidence: Evidence) -> dict[str, Any]:
    """SHA-256 of every file that the numbers come from, so that a reader can prove which folder it was."""
    runs = [("calibration run", evidence.run, evidence.manifest)]
    runs += [("verification run", one.run, one.manifest) for one in evidence.verifications]
    return {
        "runs": [
            {
                "role": role,
                "run": manifest.run,
                "manifest_sha256": sha256(run.path / MANIFEST),
                "files": dict(manifest.files),
            }
            for role, run, manifest in runs
        ],
        "calibration_sha256": sha256(evidence.run.path / evidence.stored.FILE),
    }


def _software(evidence: Evidence) -> dict[str, Any]:
    return {
        "certificate": {"bench": __version__, "commit": commit()},
        "run": dict(evidence.manifest.versions),
    }
