"""What can be wrong with a vehicle's world, as the plant does it: its own forms, beside the plain ones."""
