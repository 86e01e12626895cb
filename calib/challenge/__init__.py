"""The blind check: make sealed cases, run the diagnosis on them, score it."""
