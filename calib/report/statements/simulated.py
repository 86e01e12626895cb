"""The words that stand over everything made from a program's data."""

from __future__ import annotations

from calib.report.blocks import Notice


def simulated_notice() -> Notice:
    """Return these words."""
    return Notice("simulated", "SIMULATED DATA", "A program made these data; no vehicle was measured.")
