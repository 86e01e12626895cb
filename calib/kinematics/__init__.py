"""Radii, track and sensor together: what end poses and continuous references say about a vehicle's geometry."""
