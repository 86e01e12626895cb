"""The user's own simulator: its settings, its runs, and a diagnosis in its parameters."""
