"""Journals while a run is under way, tables when it has ended."""
