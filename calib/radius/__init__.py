"""From runs to a law: effective radii, path deviation, regression on load."""
