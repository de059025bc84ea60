"""The registry: what units, runs, calibrations, equipment and certificates there are, in one database.

It is an index and never the truth: run folders and the ledger beside them (`ledger`) make the same rows
again (`bench registry rebuild`). SQLite beside the run folders, or PostgreSQL where several stations share one.
"""
