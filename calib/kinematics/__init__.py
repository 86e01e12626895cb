"""Radii, track and sensor together, from end poses and continuous references."""
