"""A run judged: completeness, quantities, limits, validity, verdict, calibration."""
