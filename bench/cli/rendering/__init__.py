"""Text and JSON of the results of commands: one function per type of result."""

from bench.cli.rendering import analyse, centre, deliver, diagnose, imu, live, measure, stock
from bench.cli.rendering.printing import content, lines, plain, show

__all__ = [
    "analyse",
    "centre",
    "content",
    "deliver",
    "diagnose",
    "imu",
    "lines",
    "live",
    "measure",
    "plain",
    "show",
    "stock",
]
