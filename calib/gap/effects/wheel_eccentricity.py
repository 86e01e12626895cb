"""A wheel turns about a point that is not its middle."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.scales import wheel_size


class WheelEccentricity(Effect):
    """The travel of a wheel gains e [sin(phi + phi_0) - sin(phi_0)], never more than 2 e.

    Linear in e cos(phi_0) and e sin(phi_0). The wheel angle phi is the counter's, so phi_0 is common to runs only
    where the counter keeps its place between them.
    """

    id = "wheel_eccentricity"
    title = "an eccentric wheel"
    implausible = "a slipping encoder coupling"
    family = Family.COUNTS
    of_rear_wheels = True
    needs = "logs"
    separates = "the log within a run"

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms for the left wheel, the right wheel and both; none without logs."""
        if not observations.from_log.any():
            return []

        def relative(
            observations: Observations, angle: FloatArray, roll: FloatArray, radius: FloatArray
        ) -> tuple[FloatArray, FloatArray]:
            """Return the relative change of each step's travel per metre of e cos(phi_0) and of e sin(phi_0)."""
            middle, half = angle - 0.5 * roll, 0.5 * roll
            # sin(a) - sin(b) = 2 cos(middle) sin(half), so the quotient by the roll stays finite at rest
            share = (
                np.where(observations.from_log[observations.unit], np.sinc(half / np.pi), 0.0)
                / radius[observations.unit]
            )
            return np.cos(middle) * share, -np.sin(middle) * share

        kept: WeakKeyDictionary[Path, tuple[list[Push], list[Push]]] = WeakKeyDictionary()

        def sides(path: Path) -> tuple[list[Push], list[Push]]:
            """Return the pushes of the left and of the right wheel; kept, as two forms ask for each."""
            if path not in kept:
                s = path.s
                lefts = relative(s, s.phase_left_rad, s.roll_left_rad, s.radius_left_m)
                rights = relative(s, s.phase_right_rad, s.roll_right_rad, s.radius_right_m)
                kept[path] = [Push(left=part) for part in lefts], [Push(right=part) for part in rights]
            return kept[path]

        scale = wheel_size(observations)

        def parameters(side: str) -> tuple[Parameter, ...]:
            names = (f"{side}_cos", f"{side}_sin")
            return tuple(Parameter(name, "m", typical=2e-4 * scale, largest=2e-3 * scale) for name in names)

        return [
            Form(self.id, "left wheel", parameters("left"), lambda path: sides(path)[0], tries=3, by_parts=True),
            Form(self.id, "right wheel", parameters("right"), lambda path: sides(path)[1], tries=3, by_parts=True),
            Form(
                self.id,
                "both wheels",
                parameters("left") + parameters("right"),
                lambda path: [push for side in sides(path) for push in side],
                tries=3,
                by_parts=True,
            ),
        ]
