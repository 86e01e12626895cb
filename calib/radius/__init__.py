"""From runs to a law: effective radius a run and wheel, path deviation, regression on load."""
