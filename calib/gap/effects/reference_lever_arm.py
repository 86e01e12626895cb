"""The reference looks at a point that is not the middle of the rear axle."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.scales import reach
from calib.gap.effects.shapes import start_to_end_frame
from calib.gap.predict.path import predict


class ReferenceLeverArm(Effect):
    """A point l = (l_x, l_y) of the vehicle is read instead of its origin: the position moves by R(theta) l - l."""

    id = "reference_lever_arm"
    title = "a reference point off the middle of the rear axle"
    implausible = "heading errors in turns"
    family = Family.REFERENCE
    needs = "end positions of runs that turn"
    separates = "turns on the spot"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none without end positions or where no run ends turned against its start."""
        heading = predict(observations).frame
        if not (observations.usable[:, 1] & (np.abs(np.exp(1j * heading) - 1.0) > 0.02)).any():
            return []

        def push(path: Path, x: FloatArray, y: FloatArray) -> Push:
            along, lateral = start_to_end_frame(path, x, y)
            return Push.on_readings(observations, along=along, lateral=lateral)

        def pushes(path: Path) -> list[Push]:
            c, sn = np.cos(path.frame), np.sin(path.frame)
            return [push(path, c - 1.0, sn), push(path, -sn, c - 1.0)]

        scale = reach(observations)
        names = ("lever_x", "lever_y")
        parameters = tuple(Parameter(name, "m", typical=1e-2 * scale, largest=2e-1 * scale) for name in names)
        return [Form(self.id, "", parameters, pushes)]
