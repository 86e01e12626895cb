"""Simulations and replays of journeys."""
