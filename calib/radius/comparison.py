"""Comparison of fitted laws with those of a model, for example of a controller or a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calib.radius.law import RadiusLaw
from calib.radius.regression import WheelFit


@dataclass(frozen=True, slots=True)
class Difference:
    """A coefficient of one wheel, fitted minus that of a model."""

    wheel: str
    #: ``radius_ref`` in m, or ``slope`` in m/N
    quantity: str
    fitted: float
    model: float
    #: 95 % interval of the fitted coefficient
    fitted_ci95: tuple[float, float]

    @property
    def difference(self) -> float:
        """Fitted minus model."""
        return self.fitted - self.model

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of the difference; the model counts as known."""
        return self.fitted_ci95[0] - self.model, self.fitted_ci95[1] - self.model

    @property
    def inside(self) -> bool:
        """Whether the model lies within the fit's 95 % interval."""
        return self.ci95[0] <= 0.0 <= self.ci95[1]


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """Both wheels' fitted laws against a model's; a wheel without a slope has its radius alone."""

    #: load at which the radii are compared
    reference_load_N: float
    differences: tuple[Difference, ...]

    @property
    def inside(self) -> bool:
        """Whether the model lies within every interval."""
        return all(one.inside for one in self.differences)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values: the key ``model_comparison`` of ``calib fit --model --json``."""
        wheels: dict[str, dict[str, object]] = {side: {"radius_ref": None, "slope": None} for side in ("left", "right")}
        for one in self.differences:
            unit = "m" if one.quantity == "radius_ref" else "m_per_N"
            values = {name: getattr(one, name) for name in ("fitted", "model", "difference")}
            values |= {"difference_ci95": list(one.ci95)}
            document = {f"{name}_{unit}": value for name, value in values.items()}
            wheels[one.wheel][one.quantity] = document | {"model_inside": one.inside}
        return {"reference_load_N": self.reference_load_N, "model_inside": self.inside, "wheels": wheels}


def compare_laws(left: WheelFit, right: WheelFit, model: RadiusLaw) -> ModelComparison:
    """Return the differences of fitted laws from a model, at the fit's reference load.

    The intervals are the fit's own: a model of the same runs shares their errors, so it counts as known.
    """
    differences = []
    for wheel, law in ((left, model.left), (right, model.right)):
        at_load, own = float(law.radius_m(wheel.reference_load_N)), wheel.law
        differences.append(Difference(wheel.wheel, "radius_ref", own.radius_ref_m, at_load, wheel.radius_ref_ci95_m))
        if interval := wheel.slope_ci95_m_per_N:
            differences.append(Difference(wheel.wheel, "slope", own.slope_m_per_N, law.slope_m_per_N, interval))
    return ModelComparison(left.reference_load_N, tuple(differences))
