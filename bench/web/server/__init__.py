"""The server: application, gate, pages, start."""
