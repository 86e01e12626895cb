"""Observations laid end to end as arrays, and the channels that each has."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from calib.campaign.checks import listed
from calib.campaign.model import Campaign
from calib.campaign.read import looks_ahead
from calib.campaign.settings import WHEEL_LOADS
from calib.campaign.wheels import steered_by_counts, were_guided
from calib.gap.observations import N_CHANNELS, STRAIGHT_RAD, Channel, Observations, routes
from calib.gap.observations.observation import Observation, Setup, let_go, step_array
from calib.gap.observations.routes import WheelTravel, replicates, weave_of_log
from calib.types import GRAVITY_MPS2, BoolArray, FloatArray, IntArray, StrArray
from calib.vehicle import wheel_loads_N


def filled_loads(campaign: Campaign) -> tuple[FloatArray, FloatArray, bool]:
    """Return wheel loads of all runs, each (n_runs,), and whether any is known."""
    runs, vehicle = campaign.runs, campaign.vehicle
    left, right = runs.number("load_left_N"), runs.number("load_right_N")
    payload, x = runs.number("payload_kg"), runs.number("payload_x_m")
    known = bool(np.isfinite(left).any() and np.isfinite(right).any()) or bool(np.isfinite(payload).any())
    at = (np.where(np.isnan(x), vehicle.cog_x_m, x), np.nan_to_num(runs.number("payload_y_m")))
    _, by_left, by_right = wheel_loads_N(vehicle, np.nan_to_num(payload), *at)
    return np.where(np.isnan(left), by_left, left), np.where(np.isnan(right), by_right, right), known


#: columns of the format that are filled like covariates
FILLED: Final = ("temperature_C", "minutes_under_load")
#: values beyond these are absurd
PLAUSIBLE_VALUES: Final = {"temperature_C": (-50.0, 60.0)}
#: and further than so many interquartile ranges from the median
MOST_SPREADS: Final = 20.0
MOST_ODD: Final = 0.2
#: load over the empty vehicle's that is none: load cells differ by a per cent
MOST_OF_EMPTY: Final = 1.02
_LABELS = ("run_id", "session", "kind", "direction")


def assemble(setup: Setup, units: Sequence[Observation], notes: Sequence[str]) -> Observations:
    """Lay observations end to end in the order driven; determine channels and replicates."""
    campaign, model, stands_in, remarks = setup.campaign, setup.model, setup.stands_in, list(notes)
    rolls = _of_steps(units, "left_rad"), _of_steps(units, "right_rad")
    starts = np.concatenate(([0], np.cumsum(_each(units, "n_steps")))).astype(np.int64)
    travel = (rolls[0] * model.radius_left_m, rolls[1] * model.radius_right_m)
    steps = WheelTravel(starts, *travel, model.track_m, _of_steps(units, "time_s"), _each(units, "from_log"))
    front, steer = _of_steps(units, "front_rad"), _of_steps(units, "steer_rad", lambda s: 0.5 * (s[1:] + s[:-1]))
    path, turn, index = steps.total(steps.path_m), steps.total(steps.turn_rad), _each(units, "run")
    measured, usable = _measured(units, path, turn, steps.logged, remarks)
    guided, sigma_led = _guided(setup, steps, measured, usable, index, remarks, one_sensor=np.array_equal(*rolls))
    # a front wheel that drives the odometry is not compared with it
    usable[:, Channel.FRONT :] = (np.isfinite(steps.total(front + steer)) & (not stands_in))[:, None]
    measured[usable[:, Channel.FRONT], Channel.FRONT :] = 0.0
    numbers, carried_N = _numbers(campaign, units, steps, remarks)
    labels = {name: campaign.runs.label(name)[index] for name in _LABELS}
    route, condition, cell = replicates(campaign, steps, measured[:, Channel.HEADING], numbers, labels)
    return Observations(
        vehicle=campaign.vehicle,
        model=model,
        starts=steps.starts,
        roll_left_rad=rolls[0],
        roll_right_rad=rolls[1],
        phase_left_rad=_of_steps(units, "left_rad", _ends),
        phase_right_rad=_of_steps(units, "right_rad", _ends),
        time_s=_of_steps(units, "time_s", _ends),
        duration_s=steps.duration_s,
        front_roll_rad=front,
        steer_rad=steer,
        steer_change_rad=_of_steps(units, "steer_rad"),
        from_log=steps.logged,
        carried_N=carried_N,
        run=index,
        window=_each(units, "window"),
        start_pose=_each(units, "start_pose"),
        course_error=_each(units, "course_error"),
        sigma_start_rad=_each(units, "sigma_start_rad"),
        by_gyro=_each(units, "by_gyro"),
        sensor_m=(campaign.reference.sensor_x_m, campaign.reference.sensor_y_m),
        measured=measured,
        simulated=_simulated(units, measured, usable, remarks),
        usable=usable,
        numbers=numbers,
        labels=labels,
        condition=condition,
        cell=cell,
        kind=route,
        axis=_laser_axis(measured, usable),
        sigma=np.where(np.outer(guided, [0, 0, 0, 1]), sigma_led[:, None], _stated(units, campaign)),
        count_rad=(1 / setup.per_rad[0], 1 / setup.per_rad[1]),
        windowed=any(u.window > 0 for u in units),
        common_frame=setup.in_map or bool(not campaign.reference.frame and {"out", "back"} & {*labels["direction"]}),
        guided=guided,
        sigmas_assumed=_sigmas_assumed(campaign, usable),
        notes=tuple(remarks),
        by_front=stands_in and bool(np.isfinite(front).any()),
        by_shaft=stands_in and campaign.odometry.source == "shaft",
        aside_rad=None if any(u.aside_m is None for u in units) else _of_steps(units, "aside_m") / model.mean_radius_m,
    )


def _each(units: Sequence[Observation], name: str) -> np.ndarray[Any, Any]:
    return np.array([getattr(u, name) for u in units])


def _of_steps(units: Sequence[Observation], name: str, of: Callable[[FloatArray], FloatArray] = np.diff) -> FloatArray:
    fields = [(u.n_steps, getattr(u, name)) for u in units]
    parts = [np.full(n_steps, np.nan) if values is None else of(values) for n_steps, values in fields]
    joined = np.concatenate(parts, out=step_array(sum(map(len, parts))))
    let_go(joined)
    return joined


def _ends(samples: FloatArray) -> FloatArray:
    return samples[1:]


def _stated(units: Sequence[Observation], campaign: Campaign) -> FloatArray:
    reference, laser_m = campaign.reference, campaign.rangefinder.sigma_m
    values = np.array([(laser_m, u.sigma_xy_m, u.sigma_xy_m, u.sigma_theta_rad) for u in units], dtype=np.float64)
    settings = [laser_m, reference.sigma_xy_m, reference.sigma_xy_m, reference.sigma_theta_rad]
    return np.where(np.isnan(values), settings, values)


def _unwrapped(heading: FloatArray, turn: FloatArray, remarks: list[str]) -> FloatArray:
    known = np.isfinite(heading)
    if not known.any():
        return heading
    wraps = 2 * np.pi * np.round((turn - heading) / (2 * np.pi))
    # only where both then agree: the wheels may be wrong
    with np.errstate(invalid="ignore"):
        wraps = np.where(np.abs(turn - heading - wraps) < 1.0, wraps, 0.0)
    if np.abs(heading[known]).max() <= np.pi + 0.05:
        return heading + wraps
    odd = int(np.count_nonzero(wraps))
    # a few headings are wrong where all others agree with the wheels
    disagree = int(np.count_nonzero(np.abs(turn - heading - wraps)[known] >= 1.0))
    if not 0 < odd <= MOST_ODD * known.sum() or disagree > MOST_ODD * known.sum():
        return heading
    remarks.append(f"the heading of {odd} runs is a whole turn off what the wheels say, and was turned back")
    return heading + wraps


def _measured(
    units: Sequence[Observation], path: FloatArray, turn: FloatArray, logged: BoolArray, remarks: list[str]
) -> tuple[FloatArray, BoolArray]:
    measured = np.full((len(units), N_CHANNELS), np.nan)
    measured[:, :4] = [u.measured for u in units]
    measured[:, 3] = _unwrapped(measured[:, 3], turn, remarks)
    with np.errstate(invalid="ignore"):
        chord = np.hypot(measured[:, 1], measured[:, 2])
        straight = (np.abs(turn) < STRAIGHT_RAD) & ~(chord < 0.9 * np.abs(path))
        # without a log the distance tells a guided run
        guided = np.abs(np.abs(measured[:, 0]) - np.abs(path)) < 0.05 * np.abs(path)
    pose_ok = logged | straight
    usable = np.isfinite(measured)
    # along and lateral are in the frame of the measured heading, else of the wheels'
    usable[:, 1:3] &= pose_ok[:, None] & usable[:, 1:2] & usable[:, 2:3]
    usable[:, 0] &= logged | guided | (np.abs(turn) < STRAIGHT_RAD)
    if left_out := int((~pose_ok & np.isfinite(measured[:, 1])).sum()):
        remarks.append(f"{left_out} runs have an end pose but no log of a curved path: only their heading counts")
    return measured, usable


def _guided(
    setup: Setup,
    steps: WheelTravel,
    measured: FloatArray,
    usable: BoolArray,
    index: IntArray,
    remarks: list[str],
    *,
    one_sensor: bool,
) -> tuple[BoolArray, FloatArray]:
    campaign = setup.campaign
    path, turn = steps.total(steps.path_m), steps.total(steps.turn_rad)
    posed = np.asarray(np.isfinite(measured[:, 1:4]).any(axis=1))
    if one_sensor:
        posed[:] = True
    guided = were_guided(measured[:, 0], path, turn * steps.track_m, posed)
    apart_m = turn[guided] * steps.track_m
    left_m, right_m = campaign.vehicle.wheel_radius_m / setup.per_rad[:2]
    if steered_by_counts(apart_m, path[guided], (left_m, right_m)):
        milli = 1e3 * float(np.sqrt(np.mean(apart_m**2)))
        remarks.append(
            f"{int(guided.sum())} runs have a distance and no end pose, and their wheels rolled alike to within "
            f"{milli:.2g} mm, as no floor lets them: the vehicle steered by its own counts, and these runs say nothing "
            "of one wheel against the other"
        )
        guided = np.zeros_like(guided)
    amplitude, wavelength = (campaign.runs.number(name)[index] for name in ("amplitude_m", "wavelength_m"))
    sigma, assumed = routes.heading_by_straightness(amplitude, wavelength, weave_of_log(steps), np.abs(path))
    if guided.any():
        milli = 1e3 * float(np.median(sigma[guided]))
        how = "assumed" if assumed[guided].all() else "by their weave"
        remarks.append(
            f"{int(guided.sum())} runs have a distance and no end pose: guided, they are taken to end at the "
            f"heading they began with, to within {milli:.2g} mrad ({how}), so that each wheel has a radius of its own"
        )
    measured[guided, Channel.HEADING], usable[guided, Channel.HEADING] = 0.0, True
    return guided, sigma


def _simulated(units: Sequence[Observation], measured: FloatArray, usable: BoolArray, remarks: list[str]) -> FloatArray:
    simulated = np.full((len(units), N_CHANNELS), np.nan)
    simulated[:, :4] = [u.simulated for u in units]
    (laser, x, y), axis = simulated[:, :3].T, _laser_axis(measured, usable)
    simulated[:, 0] = np.where(np.isnan(laser), np.where(axis == 2, np.hypot(x, y), np.abs(x)), laser)
    known = np.isfinite(simulated) & usable
    for channel, missing in zip(Channel, (usable & ~known).sum(axis=0), strict=True):
        if known.any() and missing:
            judged = "judged against calib's own odometry"
            remarks.append(f"{missing} runs have no sim_ value for {channel.label}: {judged}")
    return np.where(known, simulated, np.nan)


def _numbers(
    campaign: Campaign, units: Sequence[Observation], steps: WheelTravel, remarks: list[str]
) -> tuple[dict[str, FloatArray], FloatArray | None]:
    left, right, known = filled_loads(campaign)
    index, path = _each(units, "run"), steps.total(steps.path_m)
    if not known and "load_left_N" not in campaign.logs.columns:
        remarks.append("no payload or wheel load is given: every run is taken as unladen")
    runs = campaign.runs
    numbers = {name: runs.number(name)[index] for name in runs.numbers}
    if (waited := numbers.get("minutes_under_load")) is not None:
        empty = runs.number("payload_kg")[index] == 0.0
        empty |= (left + right)[index] < MOST_OF_EMPTY * 2.0 * campaign.vehicle.unladen_load_N
        waited[empty & np.isnan(waited)] = 0.0
    for name in (*FILLED, *runs.covariates):
        if name in numbers:
            numbers[name] = _filled(name, numbers[name], runs.label("session")[index], runs.run_id[index], remarks)
    numbers |= {"load_left_N": left[index], "load_right_N": right[index]}
    if campaign.odometry.source == "front" and known:
        weight_N = GRAVITY_MPS2 * (campaign.vehicle.mass_kg + np.nan_to_num(runs.number("payload_kg")))
        numbers["load_front_N"] = (weight_N - left - right)[index]
    numbers["travelled_km"] = np.concatenate(([0.0], np.cumsum(np.abs(path))[:-1])) / 1000.0
    return numbers, _carried_N(units, steps, numbers)


def _carried_N(units: Sequence[Observation], steps: WheelTravel, numbers: dict[str, FloatArray]) -> FloatArray | None:
    if all(u.load_left_N is None and u.load_right_N is None for u in units):
        return None
    loads_N = []
    for name, way_m in zip(WHEEL_LOADS, (steps.left_m, steps.right_m), strict=True):
        logged, weight = _of_steps(units, name, _ends), np.maximum(np.abs(way_m), 1e-12)
        loads_N.append(np.where(np.isnan(logged), np.repeat(numbers[name], np.diff(steps.starts)), logged))
        numbers[name] = steps.total(weight * loads_N[-1]) / steps.total(weight)
    return np.stack(loads_N, axis=1)


def _filled(name: str, values: FloatArray, session: StrArray, run_id: StrArray, remarks: list[str]) -> FloatArray:
    known = np.isfinite(values)
    if not known.any():
        return values
    middle = float(np.median(values[known]))
    spread = float(np.diff(np.quantile(values[known], [0.25, 0.75]))[0])
    low, high = PLAUSIBLE_VALUES.get(name, (-np.inf, np.inf))
    if spread > 0.0:
        low, high = max(low, middle - MOST_SPREADS * spread), min(high, middle + MOST_SPREADS * spread)
    bad = ~known | (values < low) | (values > high)
    if not bad.any():
        return values
    where = f"{name} is missing or absurd in {listed(list(dict.fromkeys(run_id[bad])))}"
    if bad.sum() > MOST_ODD * len(values):
        remarks.append(f"{where}: no cause that follows it was tested; state it")
        return values
    filled = values.copy()
    for number in np.flatnonzero(bad):
        alike = ~bad & (session == session[number])
        filled[number] = np.mean(values[alike]) if alike.any() else middle
    remarks.append(f"{where}: the mean of the session stands for it")
    return filled


def _sigmas_assumed(campaign: Campaign, usable: BoolArray) -> bool:
    assumed = {str(key) for key in campaign.extra.get("assumed", ())}
    of_pose = {"reference.sigma_xy_m", "reference.sigma_theta_rad"} & assumed
    return bool(("rangefinder.sigma_m" in assumed and usable[:, 0].any()) or (of_pose and usable[:, 1:4].any()))


def _laser_axis(measured: FloatArray, usable: BoolArray) -> FloatArray:
    both = usable[:, :3].all(axis=1)
    ahead = both.any() and looks_ahead(*measured[both, :3].T)
    return np.where(both, np.where(measured[:, Channel.ALONG] < 0.0, -1.0, 1.0) if ahead else 2.0, 0.0)
