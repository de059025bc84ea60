"""Profiles, stations and plans that the page offers, and their check."""
