"""Coefficients for a unit: embedded forms of a fitted model, and the files that contain them."""
