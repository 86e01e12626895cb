"""Many vehicles: one task a vehicle and file, sums that add, and the fleet's view."""
