"""Shared parts of the server: settings, security headers, errors, request limits."""
