"""Calibrate a vehicle's wheel odometry, and find out why its simulation is wrong.

From Python:

>>> import calib
>>> campaign = calib.read("sample_runs/corridor_crossed")
>>> fit = calib.fit(campaign)
>>> diagnosis = calib.diagnose(campaign)
>>> print(diagnosis.summary())
>>> diagnosis.plot()

Nothing heavy is imported until one of these functions is called. The folders show the data's way: ``campaign`` ->
``radius`` -> ``kinematics`` -> ``coefficients`` -> ``odometry`` -> ``gap`` -> ``reporting``; each imports those before.
"""

from typing import TYPE_CHECKING, Any

from calib.documents import VERSION as __version__

if TYPE_CHECKING:
    from calib.api import describe, diagnose, export, fit, geometry, ingest, plan, read, replay, report, simulate
    from calib.campaign.ingest.describe import Description
    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis, Plan
    from calib.kinematics.result import Geometry
    from calib.odometry.replay import Replay
    from calib.odometry.simulation import Simulation
    from calib.radius.result import Fit

__all__ = [
    "Campaign", "Description", "Diagnosis", "Fit", "Geometry", "Plan", "Replay", "Simulation", "__version__",
    "describe", "diagnose", "export", "fit", "geometry", "ingest", "plan", "read", "replay", "report", "simulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from calib import api

    value = globals()[name] = getattr(api, name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
