"""Effects that tell one direction of travel from the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Perturbations, varies
from calib.gap.effects.floor import common_frame, map_heading_rad
from calib.gap.predict import predict
from calib.gap.steps import Perturbation
from calib.types import FloatArray


class RearDrag(Effect):
    """One wheel travels a share more for its counts, in one rolling sense only.

    The sense is forward where any run rolls backward; else the ``direction`` label stands for it, out against back.
    """

    id = "rear_drag"
    title = "a rear wheel that drags one way"
    implausible = "unequal radii, or a brake that does not release"
    family = Family.DIRECTION
    of_rear_wheels = True
    needs = "runs forward and backward"
    separates = "the same way forward and backward"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for the left and one for the right wheel; none where everything rolls and goes one way."""
        backward = observations.total(np.where(observations.path_m < 0.0, -observations.path_m, 0.0))
        if (backward > 0.5).any():
            # an observation that rolls one way throughout needs no steps
            one_way = bool(((backward < 1e-3) | (backward > observations.length_m - 1e-3)).all())
            forward, label = (observations.total(observations.path_m) > 0.0) if one_way else None, "rolling forward"
        elif varies(observations.heading_sign):
            forward, label = observations.heading_sign > 0.0, "going out"
        else:
            return []
        parameters = (Parameter("relative", "1", typical=5e-4, largest=5e-3),)

        def takes_part(path: Path) -> FloatArray:
            return np.asarray(path.s.path_m >= 0.0 if forward is None else path.s.here(forward), dtype=np.float64)

        wheels: dict[str, Perturbations] = {
            "left": lambda path: [Perturbation(left=takes_part(path))],
            "right": lambda path: [Perturbation(right=takes_part(path))],
        }
        return [
            Form(self.id, f"{side} wheel, {label}", parameters, perturbations, tries=2, by_parts=True)
            for side, perturbations in wheels.items()
        ]


class TravelDirection(Effect):
    """dr / r = d sigma for both wheels, sigma +1 out and -1 back."""

    id = "travel_direction"
    title = "a difference between driving out and back"
    implausible = "a sloping floor, or a start mark that differs"
    family = Family.DIRECTION
    needs = "runs out and back"
    separates = "the vehicle turned by 180 degrees on the same lane"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return two forms, unlike in runs of neither direction; none where all runs go one way."""
        sigma = observations.heading_sign
        if not varies(sigma):
            return []
        labelled = np.isin(observations.labels["direction"], ("out", "back"))
        parameter = Parameter("relative", "1", typical=1e-3, largest=5e-3)

        senses = {"along the corridor alone": np.where(labelled, sigma, 0.0), "other routes as out": sigma}
        if labelled.all():
            senses = {"": sigma}

        def form(label: str, sense: FloatArray) -> Form:
            return Form(
                self.id, label, (parameter,), lambda _: [Perturbation(left=sense, right=sense)], tries=len(senses)
            )

        return [form(*each) for each in senses.items()]


class FloorSlope(Effect):
    """By the heading phi on the floor: both radii ~ cos(phi - phi_0) with phi_0 downhill, a pull ~ sin(phi - phi_0).

    Where it slopes across a corridor, the pull goes as cos(phi): to the left going out, to the right going back.
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
        sided = bool((np.abs(across) > 0.02).any() or (observations.total(way * np.abs(np.sin(heading))) > 0.2).any())

        def radii_by(part: Callable[[FloatArray], FloatArray], path: Path) -> Perturbation:
            share = part(map_heading_rad(path))
            return Perturbation(left=share, right=share)

        def pull_by(part: Callable[[FloatArray], FloatArray], path: Path) -> Perturbation:
            return Perturbation(heading_rad=np.abs(path.s.path_m) * part(map_heading_rad(path)))

        def with_pull(path: Path) -> list[Perturbation]:
            return [radii_by(np.cos, path), pull_by(np.sin, path)]

        def any_direction(path: Path) -> list[Perturbation]:
            return [radii_by(np.cos, path), radii_by(np.sin, path)]

        offered: list[tuple[str, tuple[Parameter, ...], Perturbations]] = [
            ("along x, radii alone", (radii,), lambda path: [radii_by(np.cos, path)]),
            ("across, pull alone", (pull,), lambda path: [pull_by(np.cos, path)]),
        ]
        if sided:
            both = (replace(radii, name="radii_x"), replace(radii, name="radii_y"))
            offered.append(("along x, radii and pull", (radii, pull), with_pull))
            offered.append(("any direction, radii alone", both, any_direction))
        return [Form(self.id, *each, tries=len(offered), by_parts=True) for each in offered]
