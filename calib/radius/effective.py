"""Effective radius of each wheel and run, r_e = S / (2 pi n) (Eq. 6), with its uncertainty budget."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray, StrArray
from calib.campaign.model import Campaign
from calib.radius.path_length import correct_paths
from calib.radius.usable import LeftOut, usable_runs

#: standard deviation, in counts, of the difference of two readings of a counter that shows whole counts
QUANTISATION_COUNTS: Final = (1.0 / 6.0) ** 0.5
#: factor between measured and nominal radius that no load explains
IMPLAUSIBLE: Final = 1.2


@dataclass(frozen=True, slots=True)
class Component:
    """One line of the uncertainty budget of a single effective radius (GUM)."""

    #: ``rangefinder``, ``quantisation``, ``path``, ``other_run_to_run``, ``session_to_session``
    name: str
    #: GUM evaluation: ``A`` from repeats, ``B`` from other knowledge
    kind: str
    #: assumed distribution
    distribution: str
    #: the input quantity in words, with its standard uncertainty
    what: str
    #: contribution to the standard uncertainty of a typical (root mean square) run's radius
    std_left_m: float
    std_right_m: float
    #: degrees of freedom of an evaluation of type A; None for type B, which counts as known
    dof: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EffectiveRadii:
    """Effective radii of a campaign, arrays over the runs used, in the order driven."""

    #: as in the run table, shape (n_runs,)
    run_id: StrArray
    session: StrArray
    direction: StrArray
    load_left_N: FloatArray
    load_right_N: FloatArray
    #: S_O along the corridor, shape (n_runs,)
    distance_m: FloatArray
    #: effective radii, corrected for the path, shape (n_runs,)
    radius_left_m: FloatArray
    radius_right_m: FloatArray
    #: standard uncertainties from rangefinder, quantisation and path (type B, random from run to run), shape (n_runs,)
    std_left_m: FloatArray
    std_right_m: FloatArray
    #: relative excess of the wheel's path over S_O that was corrected; the uncorrected radius is ``radius / (1 +
    #: path)``, shape (n_runs,)
    path_left: FloatArray
    path_right: FloatArray
    #: where the correction comes from: ``log``, ``columns`` or ``none``, with ``+heading`` where the measured heading
    #: at the end was used too, shape (n_runs,)
    path_source: StrArray
    #: weave about the line, estimated or as measured; NaN where unknown, shape (n_runs,)
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    #: uncertainty budget of a single radius, for a typical run
    budget: tuple[Component, ...] = ()
    #: runs not used
    left_out: tuple[LeftOut, ...] = ()
    #: what the user should know, in sentences
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.run_id)


def effective_radii(campaign: Campaign) -> EffectiveRadii:
    """Return the effective radius of each wheel and run that can be used.

    The path is corrected where something other than the radii themselves shows it: the weave in a run's log, the
    measured heading at its end, or measured amplitude and wavelength. The total counts alone never do: a steady arc
    and unequal radii leave the same difference between them, and correcting for it would make the radii equal.

    `campaign`: excluded rows, runs that are no straight run, and runs that lack distance, counts or load are left out
    and named. Radii with their standard uncertainties. Raises RefusedError where no run can be used.
    """
    campaign, left_out, notes = usable_runs(campaign)
    runs, track = campaign.runs, campaign.vehicle.track_m
    encoder, sigma = campaign.encoder, campaign.rangefinder.sigma_m
    distance = np.abs(runs.number("distance_m"))
    path = correct_paths(campaign)
    notes = [*notes, *path.notes]
    sides = {}
    for side, per_rev, excess in (
        ("left", encoder.counts_per_rev_left, path.left),
        ("right", encoder.counts_per_rev_right, path.right),
    ):
        counts = np.abs(runs.number(f"counts_{side}"))
        radius = distance * (1 + excess) / (2 * np.pi * counts / per_rev)
        parts = {
            "rangefinder": radius * sigma / distance,
            "quantisation": radius * QUANTISATION_COUNTS / counts,
            "path": radius * np.hypot(0.5 * track * path.yaw_std_rad / distance, path.centre_std),
        }
        sides[side] = radius, parts, np.sqrt(sum(part**2 for part in parts.values()))
    notes.extend(_plausible(campaign, sides["left"][0], sides["right"][0]))
    return EffectiveRadii(
        run_id=runs.run_id,
        session=runs.label("session"),
        direction=runs.label("direction"),
        load_left_N=runs.number("load_left_N"),
        load_right_N=runs.number("load_right_N"),
        distance_m=distance,
        radius_left_m=sides["left"][0],
        radius_right_m=sides["right"][0],
        std_left_m=sides["left"][2],
        std_right_m=sides["right"][2],
        path_left=path.left,
        path_right=path.right,
        path_source=path.source,
        amplitude_m=path.amplitude_m,
        wavelength_m=path.wavelength_m,
        budget=_budget(sides["left"][1], sides["right"][1], campaign),
        left_out=left_out,
        notes=tuple(notes),
    )


def _plausible(campaign: Campaign, left: FloatArray, right: FloatArray) -> list[str]:
    nominal = campaign.vehicle.wheel_radius_m
    notes = []
    for side, radius in (("left", left), ("right", right)):
        ratio = float(np.median(radius)) / nominal
        if not 1 / IMPLAUSIBLE < ratio < IMPLAUSIBLE:
            notes.append(
                f"The {side} radii come out at {ratio:.3g} times the nominal {nominal:g} m: look for a wrong "
                "counts_per_rev (a factor 2, 4 or pi), a wrong unit or swapped columns before using them."
            )
    return notes


def _budget(left: dict[str, FloatArray], right: dict[str, FloatArray], campaign: Campaign) -> tuple[Component, ...]:
    def typical(part: FloatArray) -> float:
        return float(np.sqrt(np.mean(part**2)))

    what = {
        "rangefinder": ("normal", f"distance S_O, u = {1e3 * campaign.rangefinder.sigma_m:.2g} mm"),
        "quantisation": ("triangular", f"counts of a run, u = {QUANTISATION_COUNTS:.2f} counts"),
        "path": ("normal", "length of each wheel's path against S_O, and heading at the end"),
    }
    return tuple(
        Component(name, "B", distribution, text, typical(left[name]), typical(right[name]))
        for name, (distribution, text) in what.items()
    )
