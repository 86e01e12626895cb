"""Which runs would tell causes apart."""
