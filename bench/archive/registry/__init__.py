"""The registry: units, runs, calibrations, instruments and certificates in one database.

It is only an index: `bench registry rebuild` makes the same rows again from the run folders and the ledger beside
them. It is an SQLite file beside the run folders, or a PostgreSQL database that several stations share.
"""
