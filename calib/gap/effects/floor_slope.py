"""The floor slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push, varies
from calib.gap.effects.floor import common_frame, map_heading_rad
from calib.gap.predict.path import predict


class FloorSlope(Effect):
    """By the heading phi on the floor: both radii ~ cos(phi - phi_0) with phi_0 downhill, a pull ~ sin(phi - phi_0).

    Where it slopes across a corridor, the pull goes with cos(phi): to the left going out, to the right going back.
    """

    id = "floor_slope"
    title = "a sloping floor"
    implausible = "a difference between driving out and back of another cause"
    family = Family.DIRECTION
    needs = "runs in two headings, the poses in one frame"
    separates = "the vehicle turned by 180 degrees on the same lane"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms by slope and pull; none where it is driven one way only, or headings share no zero."""
        if not common_frame(observations):
            return []
        nominal = predict(observations)
        heading = map_heading_rad(nominal)
        way = np.abs(observations.path_m)
        length = np.maximum(observations.length_m, 1e-9)
        along, across = (observations.total(way * part(heading)) / length for part in (np.cos, np.sin))
        if not (varies(along, 0.2) or varies(across, 0.2)):
            return []
        radii = Parameter("radii", "1", typical=2e-4, largest=2e-3)
        pull = Parameter("pull", "rad/m", typical=2e-4, largest=5e-3)
        sided = bool((np.abs(across) > 0.02).any()) or bool(
            (observations.total(way * np.abs(np.sin(heading))) > 0.2).any()
        )

        def by_cos(path: Path) -> Push:
            part: FloatArray = np.cos(map_heading_rad(path))
            return Push(left=part, right=part)

        def any_way(path: Path) -> list[Push]:
            part: FloatArray = np.sin(map_heading_rad(path))
            return [by_cos(path), Push(left=part, right=part)]

        def by_sin(path: Path) -> Push:
            return Push(heading_rad=np.abs(path.s.path_m) * np.sin(map_heading_rad(path)))

        def crosswise(path: Path) -> Push:
            return Push(heading_rad=np.abs(path.s.path_m) * np.cos(map_heading_rad(path)))

        tries = 4 if sided else 2
        forms = [
            Form(self.id, "along x, radii alone", (radii,), lambda path: [by_cos(path)], tries=tries, by_parts=True),
            Form(self.id, "across, pull alone", (pull,), lambda path: [crosswise(path)], tries=tries, by_parts=True),
        ]
        if sided:
            along_and_pull = ("along x, radii and pull", (radii, pull))
            both = (replace(radii, name="radii_x"), replace(radii, name="radii_y"))
            forms.append(
                Form(self.id, *along_and_pull, lambda path: [by_cos(path), by_sin(path)], tries=tries, by_parts=True)
            )
            forms.append(Form(self.id, "any direction, radii alone", both, any_way, tries=tries, by_parts=True))
        return forms
