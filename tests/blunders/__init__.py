"""Blunders in recordings, on a plant that shares no code with the package."""
