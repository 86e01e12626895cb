"""`calib fleet`: many vehicles at once, and a fleet with known truth."""
