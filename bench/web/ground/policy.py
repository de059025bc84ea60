"""Content security policies: what a browser may do with the answers of this server.

Inline scripts, `eval` and content of other sites are forbidden. A trial in a browser showed the needs of plotly (see
docs/decisions/0007-web-stack.md): one empty style element, which it fills through the object model, and a handful of
style attributes with fixed text. They are allowed by their SHA-256, so that no other inline style is.
"""

from __future__ import annotations

import base64
import hashlib

_PIXELS = (
    "optimizeSpeed",
    "-moz-crisp-edges",
    "-o-crisp-edges",
    "-webkit-optimize-contrast",
    "optimize-contrast",
    "crisp-edges",
    "pixelated",
)

PLOTLY_ATTRIBUTES = (
    "",  # bars of colour scales
    "font-weight:bold",
    "font-style:italic",
    "font-size:70%",  # sub- and superscripts
    "".join(f"image-rendering: {value}; " for value in _PIXELS),  # without it, cells of a map smear into each other
)
"""Texts of the style attributes that plotly sets."""


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


PAGE = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        f"style-src 'self' {_hash('')}",
        f"style-src-attr 'unsafe-hashes' {' '.join(_hash(text) for text in PLOTLY_ATTRIBUTES)}",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "font-src 'self'",
        "frame-src 'self'",
        "manifest-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
"""Policy of the page."""

PART = "default-src 'none'; frame-ancestors 'none'"
"""Policy of what is no page: a part of one, which obeys the policy of its page, or data. Short: there are many."""

REPORT = "; ".join(
    (
        "sandbox allow-scripts allow-downloads",
        "default-src 'none'",
        "script-src 'unsafe-inline'",
        "style-src 'unsafe-inline'",
        "img-src data: blob:",
        "frame-ancestors 'self'",
    )
)
"""Policy of a report, which is one file with its scripts: a sandbox that can reach nothing else."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=(), unload=(self)",
}
"""Headers of every answer that does not set them itself. The page listens to `unload`, so that no browser keeps its
stream after it was left (`page/lib/live.js`)."""


def policy_of(kind: str | None) -> str:
    """Policy of an answer of this content type. Without one it says that a copy is good, which may be the page."""
    return PAGE if kind is None or kind.startswith("text/html") else PART
