"""Thermal test bench for gyroscopes: run, capture, fit, diagnose, calibrate."""

__version__ = "0.1.0"
