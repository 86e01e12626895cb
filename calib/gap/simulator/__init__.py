"""The user's simulator: settings, runs, and a diagnosis in its parameters."""
