"""From counts and radii to poses: odometry, routes, closed-loop simulation."""
