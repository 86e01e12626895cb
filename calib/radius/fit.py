"""The fit of a campaign: both wheels' laws, the runs behind them, and how to write and read all of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from calib.campaign.model import Campaign
from calib.radius.effective import EffectiveRadii, effective_radii
from calib.radius.law import RadiusLaw
from calib.radius.regression import WheelFit, fit_wheel

__all__ = ["FORMAT", "Fit", "fit_campaign", "fit_law"]

FORMAT: Final = "calib-fit/1"


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What `calib fit` finds, and all that report and export need.

    Parameters
    ----------
    name : str
        Name of the campaign.
    simulated : bool
        True where a program made the data.
    left, right : WheelFit
        The moving wheels.
    radii : EffectiveRadii
        The runs behind them.
    static : mapping of str to WheelFit
        Static radius against load by wheel, where the run table has it.
    notes : tuple of str
        What the user should know, in sentences.
    provenance : mapping
        ``version`` of calib, ``inputs`` (path -> sha256), ``arguments``; filled by the command line.
    """

    name: str
    simulated: bool
    left: WheelFit
    right: WheelFit
    radii: EffectiveRadii
    static: Mapping[str, WheelFit] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def law(self) -> RadiusLaw:
        """The law of both wheels."""
        return RadiusLaw(left=self.left.law, right=self.right.law)

    @property
    def wheels(self) -> dict[str, WheelFit]:
        """The moving wheels by name."""
        return {"left": self.left, "right": self.right}

    @property
    def passed(self) -> bool:
        """Whether every check lets the law be used."""
        return all(check.passed for wheel in (self.left, self.right) for check in wheel.checks)

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as plain values: the keys of ``calib fit --json`` and everything `from_dict` needs."""
        from calib.radius.document import fit_to_dict

        return fit_to_dict(self)

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> Fit:
        """Return the fit that `to_dict` wrote."""
        from calib.radius.document import fit_from_dict

        return fit_from_dict(value)


def fit_law(radii: EffectiveRadii, *, reference_load_N: float, name: str = "", simulated: bool = False) -> Fit:
    """Fit both wheels' laws to effective radii.

    Parameters
    ----------
    radii : EffectiveRadii
        Radii a run and wheel.
    reference_load_N : float
        Load on which the coefficients are centred.
    name, simulated
        Carried over from the campaign.

    Returns
    -------
    Fit
        With the checks of both wheels.

    Raises
    ------
    RefusedError
        With fewer than three runs.
    """
    from calib.radius.residual_checks import checked

    wheels = {}
    for wheel, load, radius in (
        ("left", radii.load_left_N, radii.radius_left_m),
        ("right", radii.load_right_N, radii.radius_right_m),
    ):
        found = fit_wheel(wheel, load, radius, radii.session, reference_load_N=reference_load_N)
        wheels[wheel] = checked(found, radii.session, radii.direction, radii.run_id)
    return Fit(
        name=name, simulated=simulated, left=wheels["left"], right=wheels["right"], radii=radii, notes=radii.notes
    )


def fit_campaign(campaign: Campaign) -> Fit:
    """Return the fit of a campaign: effective radii, both laws, and the static radius where it was measured.

    Raises
    ------
    RefusedError
        Where fewer than three runs can be used.
    """
    return fit_law(
        effective_radii(campaign),
        reference_load_N=campaign.model.reference_load_N,
        name=campaign.name,
        simulated=campaign.simulated,
    )
