"""Runs of many benches in one place, the centre: sent there, read from there, hashed anew, raw data moved there."""
