"""A blind check of the diagnosis: sealed cases, a runner that never opens the truth, a score."""
