"""Noise floor, where a model fails, which effect is missing, which experiment would tell."""
