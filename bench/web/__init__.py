"""The bench in a browser: one page application, and the HTTP API behind it.

The server reads run folders and the files of live runs, and starts runs as processes of their
own; no run depends on it.
"""
