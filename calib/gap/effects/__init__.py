"""The library of candidate causes, one file an effect, and their registry."""
