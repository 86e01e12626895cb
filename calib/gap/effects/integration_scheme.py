"""The outside simulator takes the heading at one end of its steps."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.shapes import start_to_end_frame
from calib.gap.predict.path import predict


class IntegrationScheme(Effect):
    """Exact arcs less steps along the heading at their end (Eq. 7 as printed) or start (Euler): e_n ~ v dt theta / 2.

    Calib's own odometry integrates exact arcs, so only an outside simulator's poses can have it. The difference is
    computed on the log's steps and grows with them: a share of 1 means that the simulator takes the log's steps.
    """

    id = "integration_scheme"
    title = "a simulator that integrates the heading coarsely"
    implausible = "latency, or a start heading that differs"
    family = Family.PATH
    needs = "poses of an outside simulator on runs that turn"
    separates = "none: it is computed from the logs"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the end-point and the Euler form; none without an outside simulator's poses on turning runs."""
        outside = (
            observations.from_log & np.isfinite(observations.simulated[:, 1:3]).all(axis=1) & observations.usable[:, 1]
        )
        if not outside.any():
            return []
        parameter = Parameter("share", "1", typical=1.0, largest=2.0, sign=1)

        def form(label: str, back: float) -> Form:
            def pushes(path: Path) -> list[Push]:
                heading = observations.cumulative(path.turn_rad) - back * path.turn_rad
                x = path.end[:, 0] - observations.total(path.ds_m * np.cos(heading))
                y = path.end[:, 1] - observations.total(path.ds_m * np.sin(heading))
                x, y = np.where(outside, x, 0.0), np.where(outside, y, 0.0)
                along, lateral = start_to_end_frame(path, x, y)
                # a laser's simulated distance was taken from the same pose
                far = np.maximum(np.hypot(path.end[:, 0], path.end[:, 1]), 1e-9)
                chord = (path.end[:, 0] * x + path.end[:, 1] * y) / far
                laser = np.where(observations.axis == 1, x, np.where(observations.axis == 2, chord, 0.0))
                distance = np.where(np.isfinite(observations.simulated[:, 0]), laser, 0.0)
                return [Push.on_readings(observations, distance=distance, along=along, lateral=lateral)]

            return Form(self.id, label, (parameter,), pushes, tries=2)

        forms = [form("end-point heading", 0.0), form("start heading (Euler)", 1.0)]
        nominal = predict(observations)
        reading = forms[0].pushes(nominal)[0].reading
        return forms if reading is not None and float(np.abs(reading).max()) > 1e-5 else []
