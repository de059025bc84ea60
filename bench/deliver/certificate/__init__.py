"""The calibration certificate: evidence, budget, provenance, typesetting."""
