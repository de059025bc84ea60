"""HTML report of a run, its figures and its machine-readable calibration."""
