"""The Python API: one function a stage, each returning a result with `summary`, `to_dict` and `plot`."""

from calib.api.outputs import export, plan, replay, report, simulate
from calib.api.results import describe, diagnose, fit, geometry, ingest, read
from calib.campaign.ingest.describe import Description
from calib.campaign.model import Campaign
from calib.gap.decision.diagnosis import Diagnosis, Plan
from calib.kinematics.result import Geometry
from calib.odometry.replay import Replay
from calib.odometry.simulation import Simulation
from calib.radius.result import Fit

__all__ = [
    "Campaign", "Description", "Diagnosis", "Fit", "Geometry", "Plan", "Replay", "Simulation", "describe",
    "diagnose", "export", "fit", "geometry", "ingest", "plan", "read", "replay", "report", "simulate",
]  # fmt: skip
