"""Where the gap lies: by channel, covariate, run and place."""
