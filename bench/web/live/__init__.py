"""Live runs: found, watched, mirrored, started, told about."""
