"""What the four errors of the steering angle share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.effects.effect import Form, Observations, Parameter, Push


def has_front(observations: Observations) -> BoolArray:
    """Return which units have the front wheel's counts and steering angle, shape (n_units,)."""
    if observations.by_front:
        return np.asarray(
            np.isfinite(observations.total(observations.front_roll_rad))
            & np.isfinite(observations.total(observations.steer_rad))
        )
    return observations.usable[:, 5]


def front_travel_m(observations: Observations) -> FloatArray:
    """Return the front wheel's travel of each step, 0 where it was not logged, shape (n_steps,)."""
    return (
        np.where(has_front(observations)[observations.unit], np.nan_to_num(observations.front_roll_rad), 0.0)
        * observations.vehicle.front_radius_m
    )


def steer_rad(observations: Observations) -> FloatArray:
    """Return the logged steering angle of each step, 0 where it was not logged, shape (n_steps,)."""
    return np.nan_to_num(observations.steer_rad)


def excess(observations: Observations, ahead_m: FloatArray, turn_rad: FloatArray) -> Push:
    """Return what it does that the front wheel says more than is true, by these excesses of way and turn in each step.

    Where rear wheels drive the odometry, the front channels are what these say less what the front wheel says, and grow
    by the excess. Where the front wheel alone drives it, the vehicle moves less than it says.
    """
    if observations.by_front:
        return Push(along_m=-ahead_m, heading_rad=-turn_rad)
    return Push.on_readings(observations, front=observations.total(ahead_m), steering=observations.total(turn_rad))


def error_form(
    observations: Observations,
    effect: str,
    label: str,
    parameter: Parameter,
    error_rad: FloatArray,
    *,
    tries: int = 1,
    settings: dict[str, float] | None = None,
) -> Form:
    """Return a form by which the logged steering angle is too large by `error_rad`, shape (n_steps,), per unit.

    The heading by steering, sum of ds sin(delta) / L, is then too large by ds cos(delta) error / L, and the distance by
    the front wheel, sum of ds cos(delta), too small by ds sin(delta) error. The channels are what the rear wheels say
    less that, so taking the error out of the steering's part adds the excess.

    Parameters
    ----------
    observations : Observations
        Units and steps.
    effect, label : str
        Id of the effect, and which of its forms this is.
    parameter : Parameter
        The form's only parameter.
    error_rad : array of float, shape (n_steps,)
        Error of the angle per unit of the parameter.
    tries : int
        How many forms were searched over.
    settings : dict of str to float, optional
        Quantities of the form that are not fitted.
    """
    front = front_travel_m(observations)
    ahead, turn = (
        -front * observations.steer_sin * error_rad,
        front * observations.steer_cos * error_rad / observations.vehicle.wheelbase_m,
    )
    pushes: Sequence[Push] = [excess(observations, ahead, turn)]
    return Form(effect, label, (parameter,), lambda _: pushes, tries=tries, settings=settings or {})
