"""Simulated against real: where the gap lies, which effect causes it, how far it shrinks."""
