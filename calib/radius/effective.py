"""Effective radius of each wheel and run, r_e = S / (2 pi n) (Eq. 6), with its uncertainty budget."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.model import Campaign, FloatArray, StrArray

__all__ = ["Component", "EffectiveRadii", "LeftOut", "effective_radii"]

#: standard deviation, in counts, of the difference of two readings of a counter that shows whole counts
QUANTISATION_COUNTS: Final = (1.0 / 6.0) ** 0.5


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A run that the fit does not use, and why."""

    run_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class Component:
    """One line of the uncertainty budget of a single effective radius (GUM).

    Parameters
    ----------
    name : str
        ``rangefinder``, ``quantisation``, ``path``, ``repeatability``.
    kind : str
        GUM evaluation: ``A`` from repeats, ``B`` from other knowledge.
    distribution : str
        Assumed distribution.
    what : str
        The input quantity in words, with its standard uncertainty.
    std_left_m, std_right_m : float
        Contribution to the standard uncertainty of a typical (root mean square) run's radius.
    """

    name: str
    kind: str
    distribution: str
    what: str
    std_left_m: float
    std_right_m: float


@dataclass(frozen=True, slots=True, eq=False)
class EffectiveRadii:
    """Effective radii of a campaign, arrays over the runs used, in the order driven.

    Parameters
    ----------
    run_id, session, direction : array of str, shape (n_runs,)
        As in the run table.
    load_left_N, load_right_N : array of float, shape (n_runs,)
        Wheel loads.
    distance_m : array of float, shape (n_runs,)
        S_O along the corridor.
    radius_left_m, radius_right_m : array of float, shape (n_runs,)
        Effective radii, corrected for the path.
    std_left_m, std_right_m : array of float, shape (n_runs,)
        Standard uncertainties from rangefinder, quantisation and path (type B, random from run to run).
    path_left, path_right : array of float, shape (n_runs,)
        Relative excess of the wheel's path over S_O that was corrected; the uncorrected radius is
        ``radius / (1 + path)``.
    path_source : array of str, shape (n_runs,)
        Where the correction comes from: ``log``, ``log+heading``, ``heading``, ``columns`` or ``none``.
    amplitude_m, wavelength_m : array of float, shape (n_runs,)
        Weave about the line, estimated or as measured; NaN where unknown.
    budget : tuple of Component
        Uncertainty budget of a single radius, for a typical run.
    left_out : tuple of LeftOut
        Runs not used.
    notes : tuple of str
        What the user should know, in sentences.
    """

    run_id: StrArray
    session: StrArray
    direction: StrArray
    load_left_N: FloatArray
    load_right_N: FloatArray
    distance_m: FloatArray
    radius_left_m: FloatArray
    radius_right_m: FloatArray
    std_left_m: FloatArray
    std_right_m: FloatArray
    path_left: FloatArray
    path_right: FloatArray
    path_source: StrArray
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    budget: tuple[Component, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.run_id)


def effective_radii(campaign: Campaign) -> EffectiveRadii:
    """Return the effective radius of each wheel and run that can be used.

    Parameters
    ----------
    campaign : Campaign
        Excluded rows, and runs that lack a distance or counts, are left out and named.

    Returns
    -------
    EffectiveRadii
        Radii with their standard uncertainties.

    Raises
    ------
    RefusedError
        Where no run can be used.
    """
    runs = campaign.included().runs
    n = len(runs)
    distance = np.abs(runs.number("distance_m"))
    left = distance / (2 * np.pi * np.abs(runs.number("counts_left")) / campaign.encoder.counts_per_rev_left)
    right = distance / (2 * np.pi * np.abs(runs.number("counts_right")) / campaign.encoder.counts_per_rev_right)
    zero = np.zeros(n)
    nan = np.full(n, np.nan)
    return EffectiveRadii(
        run_id=runs.run_id,
        session=runs.label("session"),
        direction=runs.label("direction"),
        load_left_N=runs.number("load_left_N"),
        load_right_N=runs.number("load_right_N"),
        distance_m=distance,
        radius_left_m=left,
        radius_right_m=right,
        std_left_m=left * campaign.rangefinder.sigma_m / distance,
        std_right_m=right * campaign.rangefinder.sigma_m / distance,
        path_left=zero,
        path_right=zero,
        path_source=np.full(n, "none"),
        amplitude_m=nan,
        wavelength_m=nan,
    )
