"""What is done to a recorded campaign: counts, reference poses, distances and columns changed as a fault would."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from calib.campaign.model import Campaign
from calib.types import FloatArray

__all__ = ["CORRIDOR", "POSES", "Manipulation"]

Change = Callable[[Campaign], Campaign]


@dataclass(frozen=True)
class Manipulation:
    """One manipulation.

    Parameters
    ----------
    name : str
        What is done.
    truth : tuple of str
        Effects that say it; the first is the effect itself, the others its exact aliases on data as these. Empty: no
        library holds it.
    change : callable
        Campaign -> the campaign as recorded with the fault.
    parameters : mapping of str to float
        ``effect.parameter`` -> its true value.
    both : bool
        Every effect of `truth` is at work, not one of them.
    """

    name: str
    truth: tuple[str, ...]
    change: Change
    parameters: dict[str, float] = field(default_factory=dict)
    both: bool = False


def _scaled(campaign: Campaign, left: FloatArray | float, right: FloatArray | float) -> Campaign:
    """Return the campaign with its counts multiplied, run by run (n_runs,); whole counts, as a counter gives them."""
    n_runs, lengths = len(campaign.runs), campaign.logs.lengths
    numbers, columns = dict(campaign.runs.numbers), dict(campaign.logs.columns)
    for name, factor in (("counts_left", left), ("counts_right", right)):
        each = np.broadcast_to(np.asarray(factor, dtype=np.float64), n_runs)
        if name in numbers:
            numbers[name] = np.rint(numbers[name] * each)
        if name in columns:
            columns[name] = np.rint(columns[name] * np.repeat(each, lengths))
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers), logs=replace(campaign.logs, columns=columns))


def _with(campaign: Campaign, **numbers: FloatArray) -> Campaign:
    return replace(campaign, runs=replace(campaign.runs, numbers={**campaign.runs.numbers, **numbers}))


def _labelled(campaign: Campaign, **labels: np.ndarray) -> Campaign:
    return replace(campaign, runs=replace(campaign.runs, labels={**campaign.runs.labels, **labels}))


def _posed(
    campaign: Campaign, move: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, ...]]
) -> Campaign:
    """Return the campaign with its reference poses moved, in the run table and in the logs."""
    names = ("ref_x_m", "ref_y_m", "ref_theta_rad")
    numbers, columns = dict(campaign.runs.numbers), dict(campaign.logs.columns)
    for table in (numbers, columns):
        if names[0] in table:
            table.update(zip(names, move(*(table[name] for name in names)), strict=True))
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers), logs=replace(campaign.logs, columns=columns))


def _drawn(campaign: Campaign, seed: int) -> FloatArray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, len(campaign.runs))


def _one_wheel(campaign: Campaign) -> Campaign:
    return _scaled(campaign, 1.01, 1.0)


def _both_wheels(campaign: Campaign) -> Campaign:
    return _scaled(campaign, 1.01, 1.01)


def _track(campaign: Campaign) -> Campaign:
    """The mean of the wheels stays, their difference grows by 3 %: the track is wider than believed."""
    numbers, columns = dict(campaign.runs.numbers), dict(campaign.logs.columns)
    for table in (numbers, columns):
        mean = 0.5 * (table["counts_left"] + table["counts_right"])
        half = 0.5 * (table["counts_right"] - table["counts_left"]) * 1.03
        table["counts_left"], table["counts_right"] = mean - half, mean + half
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers), logs=replace(campaign.logs, columns=columns))


def _lever(campaign: Campaign) -> Campaign:
    ahead, aside = 0.03, 0.02

    def move(x: FloatArray, y: FloatArray, theta: FloatArray) -> tuple[FloatArray, ...]:
        cos, sin = np.cos(theta), np.sin(theta)
        return x + cos * ahead - sin * aside - ahead, y + sin * ahead + cos * aside - aside, theta

    return _posed(campaign, move)


def _yaw(campaign: Campaign) -> Campaign:
    cos, sin = np.cos(0.03), np.sin(0.03)
    return _posed(campaign, lambda x, y, theta: (cos * x - sin * y, sin * x + cos * y, theta))


def _delay(campaign: Campaign) -> Campaign:
    """The reference is logged a third of a second late."""
    columns, numbers = dict(campaign.logs.columns), dict(campaign.runs.numbers)
    offsets = campaign.logs.offsets
    for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"):
        late, end = columns[name].copy(), numbers[name].copy()
        for run, (first, last) in enumerate(pairwise(offsets)):
            t = columns["t_s"][first:last]
            late[first:last] = np.interp(t - 0.33, t, columns[name][first:last])
            end[run] = late[last - 1]
        columns[name], numbers[name] = late, end
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers), logs=replace(campaign.logs, columns=columns))


def _payload(campaign: Campaign) -> Campaign:
    """Every third run carries a third of the vehicle's mass, every third two thirds; loaded wheels count more."""
    share = np.arange(len(campaign.runs)) % 3 / 3.0
    return _with(_scaled(campaign, 1 + 0.015 * share, 1 + 0.015 * share), payload_kg=share * campaign.vehicle.mass_kg)


def _temperature(campaign: Campaign) -> Campaign:
    warm = 10.0 * _drawn(campaign, 1)
    return _with(_scaled(campaign, 1 / (1 + 6e-4 * warm), 1 / (1 + 6e-4 * warm)), temperature_C=20.0 + warm)


def _covariate(campaign: Campaign) -> Campaign:
    humid = _drawn(campaign, 2)
    return _with(_scaled(campaign, 1 - 0.008 * humid, 1 - 0.008 * humid), humidity_pct=50.0 + 20.0 * humid)


def _there_and_back(campaign: Campaign) -> tuple[Campaign, FloatArray]:
    back = np.arange(len(campaign.runs)) % 2 == 1
    return _labelled(campaign, direction=np.where(back, "back", "out")), back.astype(np.float64)


def _drag(campaign: Campaign) -> Campaign:
    labelled, back = _there_and_back(campaign)
    return _scaled(labelled, 1 - 0.008 * back, 1.0)


def _direction(campaign: Campaign) -> Campaign:
    labelled, back = _there_and_back(campaign)
    return _scaled(labelled, 1 + 0.005 * (2 * back - 1), 1 + 0.005 * (2 * back - 1))


def _halves(campaign: Campaign) -> FloatArray:
    return (np.arange(len(campaign.runs)) >= len(campaign.runs) // 2).astype(np.float64)


def _step(campaign: Campaign) -> Campaign:
    late = _halves(campaign)
    sessions = np.array(
        [f"{name}{'b' if half else 'a'}" for name, half in zip(campaign.runs.label("session"), late, strict=True)]
    )
    return _scaled(_labelled(campaign, session=sessions), 1 + 0.01 * late, 1 + 0.01 * late)


def _interaction(campaign: Campaign) -> Campaign:
    warm, humid = _drawn(campaign, 3), _drawn(campaign, 4)
    product = 0.02 * warm * humid
    return _with(
        _scaled(campaign, 1 + product, 1 + product), temperature_C=20 + 10 * warm, humidity_pct=50 + 20 * humid
    )


def _unlogged(campaign: Campaign) -> Campaign:
    """Another pull in every eighth of the campaign, on the right wheel more; nobody wrote down of what."""
    pull = 0.01 * np.random.default_rng(5).standard_normal(8)[np.arange(len(campaign.runs)) * 8 // len(campaign.runs)]
    return _scaled(campaign, 1 + 0.3 * pull, 1 + pull)


def _swapped(campaign: Campaign) -> Campaign:
    numbers, columns = dict(campaign.runs.numbers), dict(campaign.logs.columns)
    for table in (numbers, columns):
        table["counts_left"], table["counts_right"] = table["counts_right"], table["counts_left"]
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers), logs=replace(campaign.logs, columns=columns))


def _doubled(campaign: Campaign) -> Campaign:
    return _scaled(campaign, 2.0, 1.0)


def _scaled_distance(campaign: Campaign, factor: float, offset_m: float = 0.0) -> Campaign:
    distance = campaign.runs.number("distance_m")
    return _with(campaign, distance_m=factor * distance + offset_m * np.sign(distance))


_COMMON = (
    Manipulation("one wheel's counts +1 %", ("unequal_radii", "radius_scale", "lost_counts"), _one_wheel),
    Manipulation(
        "both wheels' counts +1 %",
        ("radius_scale", "rangefinder_scale", "beam_misalignment"),
        _both_wheels,
        {"radius_scale.relative": 1 / 1.01 - 1},
    ),
    Manipulation("payload, loaded wheels smaller", ("load_radius", "load_radius_nonlinear"), _payload),
    Manipulation("temperature, 6e-4 per K", ("temperature_radius",), _temperature, {"temperature_radius.alpha": 6e-4}),
    Manipulation("a further column", ("covariate:humidity_pct",), _covariate),
    Manipulation("one wheel drags on the way back", ("rear_drag", "travel_direction", "floor_slope"), _drag),
    Manipulation("one direction goes further", ("travel_direction", "rear_drag", "floor_slope"), _direction),
    Manipulation("a step between sessions", ("session_step", "wear"), _step),
    Manipulation("outside: product of two columns", (), _interaction),
    Manipulation("outside: unlogged, by the eighth", (), _unlogged),
    Manipulation("counters swapped", ("encoder_gross",), _swapped),
    Manipulation("left counts doubled", ("encoder_gross",), _doubled),
    Manipulation(
        "temperature and a further column",
        ("temperature_radius", "covariate:humidity_pct"),
        lambda campaign: _covariate(_temperature(campaign)),
        both=True,
    ),
)

#: for campaigns with reference poses
POSES = (
    *_COMMON,
    Manipulation("track 3 % wider than believed", ("track_width",), _track, {"track_width.relative": 0.03}),
    Manipulation("lever arm of 36 mm", ("reference_lever_arm",), _lever),
    Manipulation("reference turned by 30 mrad", ("reference_yaw",), _yaw, {"reference_yaw.yaw": 0.03}),
    Manipulation("reference late by 0.33 s", ("reference_latency",), _delay, {"reference_latency.latency": 0.33}),
    Manipulation(
        "temperature and track",
        ("temperature_radius", "track_width"),
        lambda campaign: _track(_temperature(campaign)),
        both=True,
    ),
)

#: for campaigns with a distance and no poses
CORRIDOR = (
    *(each for each in _COMMON if each.name != "counters swapped"),
    Manipulation(
        "distance reads 2 % long",
        ("rangefinder_scale", "radius_scale", "beam_misalignment"),
        lambda campaign: _scaled_distance(campaign, 1.02),
    ),
    Manipulation(
        "distance reads 30 mm more", ("rangefinder_offset",), lambda campaign: _scaled_distance(campaign, 1.0, 0.03)
    ),
    Manipulation(
        "temperature and payload",
        ("temperature_radius", "load_radius"),
        lambda campaign: _payload(_temperature(campaign)),
        both=True,
    ),
)
