"""How strongly the runs speak for each hypothesis."""
