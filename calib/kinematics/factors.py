"""Lengths far from those stated: factors of wrong settings, units and times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from calib.kinematics.blunders import NEAR, TWIST, Fault
from calib.kinematics.joint_fit import Fitted

#: of wrong settings
TRACK_FACTORS: Final = {0.5: "half the track", 2.0: "twice the track"}
RADIUS_FACTORS: Final = {
    0.5: "half the radius: twice the counts per revolution, or the radius for the diameter",
    2.0: "twice the radius: half the counts per revolution, or the diameter for the radius",
    4.0: "four times the radius: a quarter of the counts per revolution (quadrature)",
    0.25: "a quarter of the radius: four times the counts per revolution (quadrature)",
    float(np.pi): "pi times the radius",
    1.0 / 0.3048: "1 / 0.3048 times: positions in feet taken for m",
    1.0 / 0.0254: "1 / 0.0254 times: positions in inches taken for m",
    1e-3: "a thousandth: positions in m taken for mm, or lengths of the settings in mm taken for m",
    1e3: "a thousand times: positions in mm taken for m",
    1e-2: "a hundredth: positions in m taken for cm, or lengths of the settings in cm taken for m",
    1e2: "a hundred times: positions in cm taken for m",
    float(np.pi / 180.0): "pi / 180 times: angles of the wheels in degrees taken for rad",
    float(180.0 / np.pi): "180 / pi times: angles of the wheels in rad taken for degrees",
}
RADII: Final = ("radius_left_m", "radius_right_m", "front_radius_m", "rear_radius_m", "wheel_radius_m")
#: a radius off by more is no radius, no matter what made it
FARTHEST: Final = 5.0
#: a length further off is a wrong setting, unit or count; rubber, wear and load stay within it
PLAUSIBLE_CHANGE: Final = 0.15
#: a track may be an effective one, of two tyres that scrub or of a wide tread
PLAUSIBLE_TRACK_CHANGE: Final = 0.3
#: skid steering turns about an effective track of 1.2 to 2.5 times the geometric one (Mandow et al., IROS 2007)
SKID_TRACK: Final = 2.5
#: what a track too wide for two wheels may be
SKID_HINT: Final = ' (an effective track? of wheels that skid in turns state drive = "skid")'


def implausible(name: str, ratio: float, most: float, drive: str) -> bool:
    """Return whether a length is off by more than a share `most`; the track of a skid-steered `drive` may be wider."""
    wider = SKID_TRACK - 1.0 if drive == "skid" and name == "track_m" else most
    return not -most <= ratio - 1.0 <= wider


def implausible_lengths(fitted: Fitted, drive: str) -> list[str]:
    """Return a `drive`'s lengths further from those stated than wheels and floors make them."""
    sentences, parameters, free = [], fitted.parameters, fitted.parameters.free
    sizes = zip(parameters.free_names, parameters.nominal[free], fitted.solution.values[free], strict=True)
    for name, nominal, value in sizes:
        if not nominal or not (name.startswith(("track", "wheelbase")) or "radius" in name):
            continue
        change, track = value / nominal - 1.0, name == "track_m"
        if implausible(name, value / nominal, PLAUSIBLE_TRACK_CHANGE if track else PLAUSIBLE_CHANGE, drive):
            also = "; play or lag of the steering acts alike: see 'calib diagnose'" if name == "wheelbase_m" else ""
            sentences.append(
                f"{name} is {100 * change:+.3g} % from the stated {nominal:.6g}, more than wheels can change: check "
                f"lengths, counts per revolution and units{SKID_HINT if track and change > 0.0 else also}"
            )
    return sentences


def factor_faults(
    ratios: Mapping[str, float], drive: str = "differential", speeds: Sequence[str] = ()
) -> tuple[Fault, ...]:
    """Return faults of settings that leave a factor on a `drive`'s lengths.

    `ratios`: found over nominal, by parameter; `speeds`: columns that stand for counts.
    """
    faults = []
    track = ratios.get("track_m", 1.0)
    factors = _speed_factors(speeds, turns=1.0 / FARTHEST < track < FARTHEST) if speeds else RADIUS_FACTORS
    for name in ("track_m", "half_length_plus_half_width_m"):
        if name in ratios and implausible(name, ratio := ratios[name], NEAR, drive):
            faults += _factor(name, ratio, TRACK_FACTORS, SKID_HINT if ratio > 1.0 and name == "track_m" else "")
    for name, ratio in ratios.items():
        if name in RADII:
            explained = _factor(name, ratio, factors)
            if not explained and ratio > 0.0 and not 1.0 / FARTHEST < ratio < FARTHEST:
                text = f"{name} is {ratio:.3g} times the nominal value; check counts per revolution and units"
                explained = [Fault("radius_factor", text)]
            faults += explained
    return tuple(faults)


def _speed_factors(speeds: Sequence[str], *, turns: bool) -> dict[float, str]:
    times, lengths = "t_s in ms taken for s", f"{speeds[0]} in mm/s taken for m/s"
    # a yaw rate, not in m/s, is off with the times alone
    what = f"{times}, or {lengths}" if TWIST not in speeds else times if turns else lengths
    return {1e-3: f"a thousandth: {what}", 1.0 / 3.6: f"1 / 3.6 times: {speeds[0]} in km/h taken for m/s"}


def _factor(name: str, ratio: float, factors: dict[float, str], hint: str = "") -> list[Fault]:
    factor = min(factors, key=lambda one: abs(ratio / one - 1.0))
    if abs(ratio / factor - 1.0) >= NEAR:
        return []
    meaning = factors[factor]
    code = "half_track" if meaning.endswith("the track") else "radius_factor"
    text = f"{name} is {ratio:.3g} times the nominal value, {meaning}{hint}; correct the settings or the mapping"
    return [Fault(code, text)]
