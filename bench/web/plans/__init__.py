"""Profiles, stations and limits that the page offers, and the check of a run."""
