"""What a simulator that has a coefficient file believes of the wheels."""

from __future__ import annotations

from calib.campaign.settings import FrontModel, MecanumModel, OdometryModel
from calib.coefficients.file import CoefficientFile
from calib.geometry.drives import STEERING_SCALE


def believed_model(file: CoefficientFile, reference_load_N: float) -> OdometryModel:
    """Return the odometry's model of a coefficient file.

    `file`: its laws, its track and, where a geometry was estimated, its front wheel or its four wheels;
    `reference_load_N`: load on which the model is centred.
    """
    law, together = file.law, file.joint_geometry
    values = {} if together is None else {name: part.value for name, part in together.parameters.items()}
    front = mecanum = None
    if together is not None and together.source == "front":
        front = FrontModel(
            values["front_radius_m"], values["wheelbase_m"], values["steering_zero_rad"], values[STEERING_SCALE]
        )
    if together is not None and together.source == "wheels":
        mecanum = MecanumModel(values["wheel_radius_m"], values["half_length_plus_half_width_m"])
    return OdometryModel(
        radius_left_m=float(law.left.radius_m(reference_load_N)),
        radius_right_m=float(law.right.radius_m(reference_load_N)),
        track_m=file.geometry.track_m,
        reference_load_N=reference_load_N,
        slope_left_m_per_N=law.left.slope_m_per_N,
        slope_right_m_per_N=law.right.slope_m_per_N,
        front=front,
        mecanum=mecanum,
    )
