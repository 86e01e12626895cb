"""Odometry of logged counts over whole logs as arrays."""
