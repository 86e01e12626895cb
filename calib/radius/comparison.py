"""A fitted law held against the law that a model believes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calib.radius.law import RadiusLaw
from calib.radius.regression import WheelFit


@dataclass(frozen=True, slots=True)
class Difference:
    """One coefficient, fitted minus believed."""

    #: the coefficient in the fit and in the model
    fitted: float
    model: float
    #: fitted minus model
    difference: float
    #: 95 % interval of the difference, the model taken as it is
    ci95: tuple[float, float]

    @property
    def inside(self) -> bool:
        """Whether the model lies within the fit's 95 % interval."""
        return self.ci95[0] <= 0.0 <= self.ci95[1]

    def to_dict(self, unit: str) -> dict[str, Any]:
        """Return it as plain values, keys ending in the unit suffix."""
        return {
            f"fitted_{unit}": self.fitted,
            f"model_{unit}": self.model,
            f"difference_{unit}": self.difference,
            f"difference_ci95_{unit}": list(self.ci95),
            "model_inside": self.inside,
        }


@dataclass(frozen=True, slots=True)
class WheelComparison:
    """One wheel's radius at the reference load and its slope; the slope is None where the fit has none."""

    radius_ref: Difference
    slope: Difference | None

    @property
    def inside(self) -> bool:
        """Whether the model lies within both intervals."""
        return self.radius_ref.inside and (self.slope is None or self.slope.inside)


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """Both wheels' fitted laws against a model's."""

    #: load at which the radii are compared
    reference_load_N: float
    #: in m, and m/N
    left: WheelComparison
    right: WheelComparison

    @property
    def inside(self) -> bool:
        """Whether the model lies within every interval."""
        return self.left.inside and self.right.inside

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values: the key ``model_comparison`` of ``calib fit --model --json``."""
        return {
            "reference_load_N": self.reference_load_N,
            "model_inside": self.inside,
            "wheels": {
                side: {
                    "radius_ref": wheel.radius_ref.to_dict("m"),
                    "slope": None if wheel.slope is None else wheel.slope.to_dict("m_per_N"),
                }
                for side, wheel in (("left", self.left), ("right", self.right))
            },
        }


def compare_laws(left: WheelFit, right: WheelFit, model: RadiusLaw) -> ModelComparison:
    """Return what the fit says differently from the model, at the fit's reference load.

    The intervals are the fit's own: the model counts as given, since a model that was made from the same runs shares
    their errors, and one that was not is judged as it stands.
    """
    compared = []
    for fit, law in ((left, model.left), (right, model.right)):
        believed = float(law.radius_m(fit.law.reference_load_N))
        slope = None
        if fit.slope_ci95_m_per_N is not None:
            slope = _difference(fit.law.slope_m_per_N, law.slope_m_per_N, fit.slope_ci95_m_per_N)
        compared.append(WheelComparison(_difference(fit.law.radius_ref_m, believed, fit.radius_ref_ci95_m), slope))
    return ModelComparison(left.law.reference_load_N, compared[0], compared[1])


def _difference(fitted: float, model: float, ci95: tuple[float, float]) -> Difference:
    return Difference(
        float(fitted), float(model), float(fitted - model), (float(ci95[0] - model), float(ci95[1] - model))
    )
