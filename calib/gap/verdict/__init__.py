"""From evidence to what is said, recommended and left open."""
