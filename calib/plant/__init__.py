"""The independent plant: vehicles driven in fine time steps through worlds whose truth is known.

It imports nothing of `calib.odometry`, `calib.radius` or `calib.gap`: what it makes is a check on them.
"""
