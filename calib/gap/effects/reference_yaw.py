"""The reference's axes are turned against the vehicle's start heading."""

from __future__ import annotations

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.shapes import start_to_end_frame


class ReferenceYaw(Effect):
    """e_n = alpha_0 S on straight runs: the end pose is read in axes turned by alpha_0."""

    id = "reference_yaw"
    title = "reference axes turned against the start heading"
    implausible = "unequal radii, or a badly placed start"
    family = Family.REFERENCE
    needs = "end positions"
    separates = "straight runs of several lengths"

    def forms(self, observations: Observations) -> list[Form]:
        """Return two forms: the position alone is turned, or position and heading; none without end poses."""
        if not observations.usable[:, 2].any():
            return []
        parameter = Parameter("yaw", "rad", typical=5e-3, largest=5e-2)

        def form(with_heading: float) -> Form:
            def pushes(path: Path) -> list[Push]:
                # turning (x, y) by alpha moves it by alpha (-y, x)
                along, lateral = start_to_end_frame(path, -path.end[:, 1], path.end[:, 0])
                return [Push.on_readings(observations, along=along, lateral=lateral, heading=with_heading)]

            label = "position and heading" if with_heading else "position alone"
            return Form(self.id, label, (parameter,), pushes, tries=2)

        return [form(0.0), form(1.0)]
