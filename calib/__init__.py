"""Calibrate a vehicle's wheel odometry, and find out why its simulation is wrong.

The folders show the data's way: ``campaign`` (what was driven and measured) -> ``radius`` (effective radius and load
law) -> ``coefficients`` (the law as the vehicle gets it) -> ``motion`` (odometry, routes, simulation) -> ``gap``
(simulated against real) -> ``report``. A folder imports only folders before it. Nothing heavy is imported here.
"""

__version__ = "0.1.0"

__all__ = ["__version__"]
