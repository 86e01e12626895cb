"""The independent plant: vehicles driven in fine steps through known worlds.

It imports nothing of `calib.odometry`, `calib.radius` or `calib.gap`: it checks them.
"""
