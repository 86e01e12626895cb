"""``calib simulate``: routes, journeys under a law, the paper's studies, and replays of logged runs."""
