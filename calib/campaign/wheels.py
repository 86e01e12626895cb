"""The wheels that drive a vehicle's odometry, and the two on one axle that they amount to.

Diagnosis, replay and the runtime's check read others than two on an axle through `on_one_axle`.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from calib.campaign.model import Border, Campaign, Logs
from calib.campaign.settings import Encoder, FrontModel, MecanumModel, Odometry, OdometryModel, OdometrySource
from calib.errors import BadInputError
from calib.types import BoolArray, FloatArray, since_start
from calib.vehicle import Vehicle

#: what drives the odometry -> columns of the log with the counts of its wheels
WHEEL_COLUMNS: Final[dict[str, tuple[str, ...]]] = {
    "rear": ("counts_left", "counts_right"),
    "front": ("counts_front",),
    "wheels": ("counts_front_left", "counts_front_right", "counts_rear_left", "counts_rear_right"),
    "shaft": ("counts_rear",),
}
#: needs the steering angle
STEERED: Final = ("front", "shaft")
#: what drives the odometry -> its name in messages
SOURCE_NAMES: Final = {
    "rear": "two rear wheels",
    "front": "the front wheel",
    "wheels": "four wheels",
    "shaft": "the drive shaft and the steering",
}
#: column in memory: way to the left since the start, rolled or slipped, m
ASIDE: Final = "aside_m"
#: no wheel is driven slower: of 0.1 m, 1 mm/s
SLOWEST_RADPS: Final = 0.01
#: motion of the axle's middle ahead and to the left (m) and turn (rad) in each step
Motion = tuple[FloatArray, FloatArray, FloatArray]


def logged_columns(source: str) -> tuple[str, ...]:
    """Return the columns of a log that an odometry by `source` needs."""
    return (*WHEEL_COLUMNS[source], *(("steer_rad",) if source in STEERED else ()))


def odometry_source(campaign: Campaign) -> OdometrySource:
    """Return what drives the odometry, one of `WHEEL_COLUMNS`: as the settings say, else as logged."""
    if (stated := campaign.odometry.source) is not None:
        return stated
    if campaign.vehicle.drive == "mecanum":
        return "wheels"
    if campaign.vehicle.drive == "ackermann" and _lacks_rear(campaign):
        return "shaft"
    return "front" if _lacks_rear(campaign) and _logged(campaign.logs, "front") else "rear"


def without_rear_wheels(campaign: Campaign) -> bool:
    """Return whether the odometry runs on others than two on an axle, and no rear wheel is counted by itself."""
    return odometry_source(campaign) != "rear" and _lacks_rear(campaign)


def counted_source(campaign: Campaign) -> str:
    """Return the source of `WHEEL_COLUMNS` that is counted: the rear wheels wherever they are."""
    return odometry_source(campaign) if _lacks_rear(campaign) else "rear"


def on_its_source_alone(campaign: Campaign) -> Campaign:
    """Return the campaign without rear wheels' counts where its odometry runs on others."""
    if campaign.odometry.source in (None, "rear"):
        return campaign
    columns, numbers = (
        {name: of[name] for name in of if name not in WHEEL_COLUMNS["rear"]}
        for of in (campaign.logs.columns, campaign.runs.numbers)
    )
    logs, runs = replace(campaign.logs, columns=columns), replace(campaign.runs, numbers=numbers)
    return replace(campaign, logs=logs, runs=runs)


def _logged(logs: Logs, source: str) -> bool:
    return all(name in logs.columns and not np.isnan(logs.columns[name]).all() for name in WHEEL_COLUMNS[source])


def _lacks_rear(campaign: Campaign) -> bool:
    return not _logged(campaign.logs, "rear") and bool(np.isnan(campaign.runs.number("counts_left")).all())


def on_one_axle(campaign: Campaign, model: OdometryModel | None = None) -> Campaign:
    """Return the campaign with the counts that two wheels on one axle would have had.

    What mecanum wheels roll to the side is the column `ASIDE`. `model`: the campaign's own by default; its `front` or
    `mecanum` replaces the vehicle's nominal lengths. Raises BadInputError where a mecanum vehicle lacks its l + w.
    """
    if not without_rear_wheels(campaign):
        return campaign
    source, model = odometry_source(campaign), model or campaign.model
    encoder, logs = campaign.encoder, campaign.logs
    n = int(logs.offsets[-1])
    counts = {name: np.full(n, np.nan) for name in WHEEL_COLUMNS["rear"]}
    aside = np.full(n, np.nan)
    if source in STEERED:
        front = model.steered(campaign.vehicle)
        # counts as fine as those of the counted wheel
        per_m = counts_per_rev(encoder, source)[0] / (2 * np.pi * front.radius_m)
        encoder = replace(
            encoder,
            counts_per_rev_front=counts_per_rev(encoder, source)[0],
            counts_per_rev_left=2 * np.pi * model.radius_left_m * per_m,
            counts_per_rev_right=2 * np.pi * model.radius_right_m * per_m,
        )
    per_m_left = encoder.counts_per_rev_left / (2 * np.pi * model.radius_left_m)
    per_m_right = encoder.counts_per_rev_right / (2 * np.pi * model.radius_right_m)
    for run, log in logs.each(2, *logged_columns(source)):
        ahead, left, turn = _motion(campaign, model, source, log)
        part = slice(int(logs.offsets[run]), int(logs.offsets[run + 1]))
        half = 0.5 * model.track_m * turn
        counts["counts_left"][part] = np.cumsum(ahead - half) * per_m_left
        counts["counts_right"][part] = np.cumsum(ahead + half) * per_m_right
        aside[part] = np.cumsum(left)
    columns = {**logs.columns, **counts, **({ASIDE: aside} if np.any(aside[np.isfinite(aside)] != 0.0) else {})}
    last = np.maximum(logs.offsets[1:] - 1, 0)
    ends = {name: np.where(logs.present, column[last], np.nan) for name, column in counts.items()} if n else {}
    counted = replace(campaign.runs, numbers={**campaign.runs.numbers, **ends})
    logs = replace(logs, columns=columns)
    return replace(campaign, encoder=encoder, odometry=Odometry(source), runs=counted, logs=logs)


def turn_between_samples_rad(campaign: Campaign) -> FloatArray:
    """Return how uncertain the turn of each run is, (n_runs,): steered at any moment between two samples.

    A jump is uniform over a step: a twelfth of its square. It shows as two second differences.
    """
    source, square = odometry_source(campaign), np.zeros(len(campaign.runs))
    front, bend = campaign.model.steered(campaign.vehicle), np.tan if source == "shaft" else np.sin
    per_m = counts_per_rev(campaign.encoder, source)[0] / (2 * np.pi * front.radius_m)
    for run, log in campaign.logs.each(2, *logged_columns(source)):
        way_m = np.abs(np.diff(log[WHEEL_COLUMNS[source][0]])) / per_m
        bent = np.diff(bend(log["steer_rad"]), 2) * np.maximum(way_m[1:], way_m[:-1]) / front.wheelbase_m
        square[run] = float(np.nansum(bent**2)) / 24.0
    return np.sqrt(square)


def _motion(campaign: Campaign, model: OdometryModel, source: str, log: Mapping[str, FloatArray]) -> Motion:
    encoder = campaign.encoder
    if source in STEERED:
        front = model.steered(campaign.vehicle)
        counts = log[WHEEL_COLUMNS[source][0]]
        rolled = np.diff(counts, prepend=counts[:1]) * (2 * np.pi / counts_per_rev(encoder, source)[0])
        if source == "shaft":
            return shaft_motion(front, rolled, log["steer_rad"], log["t_s"])
        ahead, turn = front_motion(front, rolled, log["steer_rad"])
        return ahead, np.zeros_like(ahead), turn
    wheels = mecanum_model(campaign, model)
    quarters = [
        0.25 * wheels.radius_m * each / model.mean_radius_m for each in (model.radius_left_m, model.radius_right_m)
    ]
    front_left, front_right, rear_left, rear_right = (
        np.diff(log[name], prepend=log[name][:1]) * (2 * np.pi / encoder.per_rev(name)) * quarter
        for name, quarter in zip(WHEEL_COLUMNS["wheels"], (*quarters, *quarters), strict=True)
    )
    return (
        front_left + front_right + rear_left + rear_right,
        -front_left + front_right + rear_left - rear_right,
        (-front_left + front_right - rear_left + rear_right) / wheels.arm_m,
    )


def counts_per_rev(encoder: Encoder, source: str) -> tuple[float, ...]:
    """Return the counts per revolution of the wheels of `WHEEL_COLUMNS`; of a drive shaft, the rear wheels'."""
    return tuple(map(encoder.per_rev, WHEEL_COLUMNS[source]))


def mecanum_model(campaign: Campaign, model: OdometryModel | None = None) -> MecanumModel:
    """Return four mecanum wheels as a model, the campaign's own by default, has them.

    Else the mean of its radii, and l + w that differs from the vehicle's as its track does. Raises BadInputError where
    the vehicle lacks l + w.
    """
    model, vehicle = model or campaign.model, campaign.vehicle
    if model.mecanum is not None:
        return model.mecanum
    if (arm := vehicle.half_length_plus_half_width_m) is None:
        key, expected = "vehicle.half_length_plus_half_width_m", "half the wheelbase plus half the track"
        raise BadInputError(f"campaign.toml, {key}: found nothing; expected {expected} of the mecanum vehicle; give it")
    return MecanumModel(model.mean_radius_m, arm * model.track_m / vehicle.track_m)


def front_motion(front: FrontModel, rolled_rad: FloatArray, steer_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the axle's motion ahead (m) and turn (rad) in each step of the front wheel (Eqs 12 to 14).

    `rolled_rad` (shape (n,)): since the sample before; `steer_rad` (shape (n,)): at the samples, by the sensor.
    """
    angle = front.scale * steer_rad + front.zero_rad
    before = np.concatenate((angle[:1], angle[:-1]))
    # means over a step's ends: over a whole turn their errors cancel
    cosine = 2.0 / (1.0 / np.cos(before) + 1.0 / np.cos(angle))
    ahead = front.radius_m * rolled_rad * cosine
    return ahead, 0.5 * ahead * (np.tan(before) + np.tan(angle)) / front.wheelbase_m


#: a speed is taken over this: longer than a count, shorter than a change of speed
SPEED_SPAN_S: Final = 0.2


def smoothed_speed_mps(way_m: FloatArray, t_s: FloatArray) -> FloatArray:
    """Return the speed at the samples, shape (n,), over `SPEED_SPAN_S` about each, or over three samples."""
    if len(t_s) < 2:
        return np.zeros(len(t_s))
    half = max(1, int(np.rint(0.5 * SPEED_SPAN_S / max(float(np.median(np.diff(t_s))), 1e-6))))
    index = np.arange(len(t_s))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(t_s) - 1)
    span = t_s[after] - t_s[before]
    return (way_m[after] - way_m[before]) / np.where(span > 0.0, span, np.inf)


def lengthening(over: FloatArray) -> FloatArray:
    """Return the factor on the wheelbase by which understeer, `over` = K v^2, widens turns: 1 + over, never below 0.

    Of oversteer, below 0, it is 1 / (1 - over): the same to first order, and no turn on the spot at any speed.
    """
    return np.where(over >= 0.0, 1.0 + np.abs(over), 1.0 / (1.0 - np.minimum(over, 0.0)))


def shaft_motion(model: FrontModel, rolled_rad: FloatArray, steer_rad: FloatArray, t_s: FloatArray) -> Motion:
    """Return the rear axle's motion ahead and to the left (m) and turn (rad) in each step, Ackermann drive.

    At the curvature tan(angle) / wheelbase, less by the model's slip. Shapes as for `front_motion`.
    """
    tangent = np.tan(model.scale * steer_rad + model.zero_rad)
    before = np.concatenate((tangent[:1], tangent[:-1]))
    ahead = model.radius_m * rolled_rad
    square = smoothed_speed_mps(np.cumsum(ahead), t_s) ** 2
    turn = 0.5 * ahead * (before + tangent) / (model.wheelbase_m * lengthening(model.understeer_s2_per_m2 * square))
    return ahead, -model.side_slip_s2_per_m * square * turn, turn


#: replaced by counts in memory
SPEEDS: Final = ("speed_left_mps", "speed_right_mps", "speed_rear_mps", "v_mps", "omega_radps")


def with_counts(logs: Logs, encoder: Encoder, vehicle: Vehicle, border: Border) -> Logs:
    """Return the logs with counts of the logged speeds, by trapezoids; logged counts are kept.

    ``v_mps`` and ``omega_radps`` are the speeds v -+ omega track / 2 of the wheels. `vehicle`: its nominal radius and
    track gave the speeds; `border` takes what was done.
    """
    columns = dict(logs.columns)
    sides = [side for side in ("left", "right", "rear") if f"speed_{side}_mps" in columns]
    wheels = [(f"counts_{side}", columns[f"speed_{side}_mps"]) for side in sides]
    if {"v_mps", "omega_radps"} <= columns.keys():
        half = 0.5 * vehicle.track_m * columns["omega_radps"]
        wheels = [("counts_left", columns["v_mps"] - half), ("counts_right", columns["v_mps"] + half), *wheels]
    for name, speed_mps in wheels:
        way_m = _integral(speed_mps, columns["t_s"], logs)
        counts = way_m * (encoder.per_rev(name) / (2.0 * np.pi * vehicle.wheel_radius_m))
        logged = columns.get(name)
        columns[name] = counts if logged is None else np.where(np.isnan(logged), counts, logged)
        border.say("logs", f"{name} integrated from speeds, by the nominal radius", "speeds")
    kept = {name: column for name, column in columns.items() if name not in SPEEDS}
    return Logs(logs.offsets, kept, tuple(name for name in SPEEDS if name in columns))


def _integral(rate: FloatArray, t_s: FloatArray, logs: Logs) -> FloatArray:
    step = np.zeros(len(rate))
    step[1:] = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)
    begin = logs.offsets[:-1][logs.lengths > 0]
    step[begin] = 0.0
    return np.where(np.isfinite(rate), since_start(np.nan_to_num(step), np.append(begin, len(rate))), np.nan)


#: wheels within this share may have rolled a straight line
MAX_WHEEL_DIFFERENCE: Final = 0.02
#: on a straight line the distances measured and rolled agree to this share
DISTANCE_AGREEMENT: Final = 0.05
#: share of the way to which wheels a thousandth apart roll alike once in fifty times; the smoothest real robot's
#: part by five times more over 40 m
ALIKE_BY_CHANCE: Final = 2.5e-5
#: fewer may roll equal wheels by chance
MIN_GUIDED_RUNS: Final = 5


def were_guided(distance_m: FloatArray, path_m: FloatArray, apart_m: FloatArray, posed: BoolArray) -> BoolArray:
    """Return which observations were guided along a line, by measurements alone, shape (n_obs,) as all.

    `path_m`, `apart_m`: what the wheels rolled, and the right beyond the left; `posed`: with a measured end pose or
    heading.
    """
    way = np.abs(path_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.abs(distance_m) / way
        known = ratio[np.isfinite(ratio) & ~posed]
        along = np.abs(ratio / (np.median(known) if len(known) else 1.0) - 1.0) < DISTANCE_AGREEMENT
    guided: BoolArray = along & (np.abs(apart_m) < MAX_WHEEL_DIFFERENCE * way) & ~posed
    return guided


def steered_by_counts(apart_m: FloatArray, way_m: FloatArray, count_m: tuple[float, float]) -> bool:
    """Return whether wheels rolled so alike, run by run, that the vehicle kept them so.

    Led along a line, they part by their radii. Where counting is coarser, runs are taken as guided.
    """
    if len(apart_m) < MIN_GUIDED_RUNS:
        return False
    # the first and the last count are each off by a uniform share
    counting = (count_m[0] ** 2 + count_m[1] ** 2) / 6.0
    alike = float(np.mean((ALIKE_BY_CHANCE * way_m) ** 2))
    return counting < 4.0 * alike and float(np.mean(apart_m**2)) < counting + alike


def steered_itself_m(campaign: Campaign) -> float:
    """Return how far the wheels parted, root mean square, where the vehicle kept them alike, else NaN.

    By runs along a line whose heading nothing measured, and equal radii or those of the model.
    """
    runs, model = campaign.runs, campaign.model
    if odometry_source(campaign) != "rear":
        return np.nan
    for radii in ((campaign.vehicle.wheel_radius_m,) * 2, (model.radius_left_m, model.radius_right_m)):
        per_rev = (campaign.encoder.counts_per_rev_left, campaign.encoder.counts_per_rev_right)
        count_m = (2 * np.pi * radii[0] / per_rev[0], 2 * np.pi * radii[1] / per_rev[1])
        left, right = runs.number("counts_left") * count_m[0], runs.number("counts_right") * count_m[1]
        way, apart = 0.5 * (left + right), right - left
        guided = were_guided(runs.number("distance_m"), way, apart, np.isfinite(runs.number("ref_theta_rad")))
        # one speed written for both wheels says nothing of steering
        if apart[guided].any() and steered_by_counts(apart[guided], way[guided], count_m):
            return float(np.sqrt(np.mean(apart[guided] ** 2)))
    return np.nan
