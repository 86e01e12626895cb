"""What the model says of the same runs, and what small changes do to it."""
