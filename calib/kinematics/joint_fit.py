"""Joint estimation of the parameters that the data determine; others are held and named.

Some parameters differ between recordings: the reference's delay, and the zero of the steering angle, since a servo, or
a linkage with play, rests at another angle each time. One zero for all bends what the other parameters say; a free zero
for each says nothing of a further recording. So the deviations are random effects: generalised least squares estimates
the common zero and the other parameters, each deviation is the mean of its distribution given the data, and the spread
is part of the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.wheels import mecanum_model
from calib.errors import RefusedError
from calib.kinematics import drives
from calib.kinematics.drives import GYRO_SCALE, SENSOR, STEERING_SCALE, STEERING_ZERO, Drive, MeanHeld, Parameters
from calib.kinematics.model import Model, Segments
from calib.kinematics.recording import Recording
from calib.kinematics.solve import DEGREES, Shared, Solution, planned, solve
from calib.kinematics.uncertainty import Uncertainty, clustered, expected, flattened, whitened
from calib.types import FloatArray, IntArray

#: a direction with more than this part of the prior spread left is not determined
TOLERATED: Final = 0.5
#: prior, of the scale of radii and track, relative
NOMINAL_STD: Final = 0.01
#: part that each of three parameters has in a direction in which all grow alike; 0.58 where they do so exactly
ALIKE: Final = 0.3


def weakest(solution: Solution, parameters: Parameters) -> FloatArray | None:
    """Return the least determined direction, shape (n_free,); None where all are determined.

    By the whitened Jacobian, in units of each parameter's prior spread.
    """
    free = parameters.free
    jacobian = flattened(whitened(solution, free)[0] * parameters.prior_std[free])
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=False)
    return None if singular[-1] * TOLERATED >= 1.0 else np.asarray(directions[-1])


def loosest(std: FloatArray, parameters: Parameters) -> str | None:
    """Return the parameter of the largest standard deviation over prior spread, if too large.

    `std` (shape (n_free,)): standard deviations that allow for shared noise.
    """
    ratio = std / parameters.prior_std[parameters.free]
    at = int(np.argmax(ratio))
    return parameters.free_names[at] if ratio[at] > TOLERATED else None


#: a delay is sought where samples are at most so far apart
LONGEST_STEP_S: Final = 0.25
#: loads that vary by less than this part of their mean say nothing of a slope
LOADS_VARY: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A fit: model, parameters, solution and covariance."""

    model: Model
    parameters: Parameters
    solution: Solution
    uncertainty: Uncertainty
    dropped: tuple[str, ...]
    #: with steering angles as logged
    logged: Recording
    #: standard deviation of single recordings' steering zeros, corrected for in the model's angles; 0: one zero suits
    #: all
    zero_spread_rad: float = 0.0

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters that the data leave open; the mean radius where it was held."""
        return (*self.dropped, *(["mean_radius_m"] if isinstance(self.model.drive, MeanHeld) else []))

    @property
    def spread(self) -> float:
        """Mean logarithm of the drive parameters' standard deviations beside their prior ones."""
        n_drive = len(self.parameters.items) - len(SENSOR)
        free = self.parameters.free
        std = self.parameters.prior_std.copy()
        std[free] = self.uncertainty.apart
        if isinstance(self.model.drive, MeanHeld):
            # holding the mean does not improve the knowledge of it
            std[:n_drive] = np.hypot(std[:n_drive], NOMINAL_STD * self.solution.values[:n_drive])
        return float(np.mean(np.log(std[:n_drive] / self.parameters.prior_std[:n_drive])))


def drive_of(campaign: Campaign, source: str, recording: Recording) -> Drive:
    """Return the drive with its nominal values.

    `source` (one of `WHEEL_COLUMNS`); `recording`: says whether the loads varied, so that radii have slopes.
    """
    vehicle, model = campaign.vehicle, campaign.model
    if source == "front":
        return drives.FrontWheel(vehicle.front_radius_m, vehicle.wheelbase_m)
    if source == "shaft":
        return drives.rear_shaft(vehicle.wheel_radius_m, vehicle.wheelbase_m, recording.steps)
    if source == "wheels":
        wheels = mecanum_model(campaign)
        return drives.Mecanum(wheels.radius_m, wheels.arm_m)
    loads = recording.steps.load_offset_N
    varied = loads is not None and bool(np.all(np.ptp(loads, axis=1) > LOADS_VARY * max(model.reference_load_N, 1.0)))
    slopes = (model.slope_left_m_per_N, model.slope_right_m_per_N)
    return drives.Differential(model.radius_left_m, model.radius_right_m, model.track_m, varied, *slopes)


def fit_parameters(
    campaign: Campaign,
    drive: Drive,
    recording: Recording,
    segments: Segments,
    sensor: bool,
    start: Fitted | None = None,
    known: FloatArray | None = None,
) -> Fitted:
    """Estimate, and leave out what is not determined, one by one; see `Fitted`.

    `sensor`: estimate the sensor's pose and delay, too; `start`: a fit to begin from; `known`: variances of the noise,
    shape (4,), for runs not driven yet.
    """
    free = [item.name for item in drive.parameters]
    dropped: list[str] = []
    if segments.gyro.any():
        free.append(GYRO_SCALE)
    if sensor:
        free += SENSOR[1:]
        if float(np.median(np.diff(recording.t_s))) > LONGEST_STEP_S:
            dropped.append(free.pop())
    parameters = Parameters.of(drives.parameters_of(drive, campaign.reference), free)
    model = Model(drive, recording, segments)
    values = parameters.nominal
    if start is not None and start.model.drive == drive:
        values = np.where(parameters.free, start.solution.values, values)
    while parameters.free.any():
        if known is None:
            solution = solve(model, parameters, values, drives.first_scales(campaign.reference))
        else:
            solution = planned(model, values, known)
        pair = isinstance(drive, drives.Differential) and not drive.slopes and bool(parameters.free[:3].all())
        weak = weakest(solution, parameters)
        if weak is not None:
            loose: str | None = parameters.free_names[int(np.argmax(np.abs(weak)))]
            alike = pair and np.min(np.abs(weak[:3])) > ALIKE
        else:
            if known is None:
                uncertainty = clustered(solution, parameters, recording, segments)
            else:
                uncertainty = expected(solution, parameters.free, segments.run)
            loose = loosest(uncertainty.std, parameters)
            lengths = solution.values[:3]
            alike = pair and np.mean(uncertainty.covariance[:3, :3] / np.outer(lengths, lengths)) > NOMINAL_STD**2
        # only the scale of radii and track is open
        if alike and isinstance(drive, drives.Differential):
            return fit_parameters(campaign, MeanHeld(drive), recording, segments, sensor, known=known)
        if loose is None:
            return Fitted(model, parameters, solution, uncertainty, tuple(dropped), recording)
        dropped.append(loose)
        parameters = parameters.without(loose)
        values = np.where(parameters.free, solution.values, parameters.nominal)
    raise RefusedError(
        f"geometry of {campaign.name!r}: found nothing that these runs determine; expected runs with turns and "
        "straights and a reference of their end poses; drive squares both ways"
    )


#: of taking one delay for several
CHANCE: Final = 0.001
#: how far from the common delay one is sought, and in how many steps
REACH_S: Final = 0.5
TRIED: Final = 51
#: for a recording's own delay
FEWEST_BLOCKS: Final = 4


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of the reference's stamps in one session, or run of a single session."""

    label: str = field(metadata={"json": "recording"})
    value_s: float = field(metadata={"json": "value"})
    std_s: float = field(metadata={"json": "sd"})


def sought_delays(fitted: Fitted) -> FloatArray:
    """Return each run's delay from the common one, shape (n_runs,), by grid search.

    The robust fit takes a recording with another delay for an outlier: the gradient does not find its delay. Zero where
    the common delay fits best.
    """
    model, solution, group = fitted.model, fitted.solution, fitted.model.recording.group
    nothing = model.recording.delay_added_s
    if not fitted.parameters.free[-1] or not group.any():
        return nothing
    offsets, delay = np.linspace(-REACH_S, REACH_S, TRIED), np.eye(len(solution.values))[-1]
    losses = []
    for offset in offsets:
        residuals = model.predict(solution.values + offset * delay).residuals
        loss = np.log1p(np.square(np.einsum("nij,nj->ni", solution.whitener, residuals)).sum(axis=1) / DEGREES)
        losses.append(np.bincount(group[model.segments.run], loss, minlength=group.max() + 1))
    best = offsets[np.argmin(losses, axis=0)]
    return nothing if np.ptp(best) < 1.5 * (offsets[1] - offsets[0]) else nothing + best[group]


def own_delays(fitted: Fitted) -> tuple[tuple[Delay, ...], FloatArray]:
    """Return the delay of each recording in the order driven, and what each run adds to the common one, (n_runs,).

    None of either where one delay fits all. The recording, in windows, knows what each run was taken to add so far.
    """
    recording, common = fitted.model.recording, float(fitted.solution.values[-1])
    shifts = shifts_of(fitted, "delay_s")
    if shifts is None:
        return (), np.zeros(0)
    group, shift, std = shifts
    added = recording.delay_added_s + shift[group]
    first = np.unique(group, return_index=True)[1]
    if not _disagree(added[first], std):
        return (), np.zeros(0)
    values, labels = (common + added).tolist(), recording.labels.tolist()
    return tuple(Delay(labels[at], values[at], float(std[group[at]])) for at in sorted(first)), added


def shifts_of(fitted: Fitted, name: str) -> tuple[IntArray, FloatArray, FloatArray] | None:
    """Return by how much each recording alone would change one parameter of a joint fit of windows.

    The group of each run (n_runs,), and each group's shift with its standard deviation (n_groups,); None where the
    parameter is not free or blocks are too few.
    """
    segments, parameters, group = fitted.model.segments, fitted.parameters, fitted.model.recording.group
    if name not in parameters.free_names or not group.any():
        return None
    jacobian, residuals = whitened(fitted.solution, parameters.free)
    slope = jacobian[:, :, parameters.free_names.index(name)]
    _, first, block = np.unique(segments.block, return_index=True, return_inverse=True)
    of_block = group[segments.run[first]]
    information = np.bincount(block, np.square(slope).sum(axis=1))
    score = np.bincount(block, np.sum(slope * residuals, axis=1))
    n_blocks, size, total = (np.bincount(of_block, part, group.max() + 1) for part in (None, information, score))
    if n_blocks.min() < FEWEST_BLOCKS or not (size > 0.0).all():
        return None
    shift = total / size
    # about its own value: the score of a common shift in each block is no noise
    about = score - shift[of_block] * information
    return group, shift, np.sqrt(np.bincount(of_block, np.square(about))) / size


def steering_zero_spread_rad(fitted: Fitted) -> float:
    """Return the steering zero's standard deviation between recordings; 0 where they agree."""
    shifts = shifts_of(fitted, STEERING_ZERO)
    if shifts is None or not _disagree(*shifts[1:]):
        return 0.0
    _, shift, std = shifts
    return float(np.sqrt(max(float(np.var(shift, ddof=1)) - float(np.mean(np.square(std))), 0.0)))


def _disagree(shift: FloatArray, std: FloatArray) -> bool:
    from scipy.special import chdtrc

    weight = 1.0 / np.square(std)
    mean = float(np.sum(weight * shift) / np.sum(weight))
    return bool(chdtrc(len(shift) - 1.0, float(np.sum(weight * np.square(shift - mean)))) < CHANCE)


#: rounds of parameters, deviations and their spread; the spread of eight recordings is settled to 0.1 % after five
ROUNDS: Final = 8
#: of these, with the noise estimated again
NOISE_ROUNDS: Final = 4
#: last change of the spread, relative
SETTLED: Final = 0.01


def with_own_zeros(fitted: Fitted) -> Fitted:
    """Return the fit with a steering zero for each recording; the fit itself where one zero suits all.

    The angles of the model's recording are then those by their own zeros.
    """
    if not (spread := steering_zero_spread_rad(fitted)):
        return fitted
    parameters, model, logged = fitted.parameters, fitted.model, fitted.model.recording
    group = logged.group
    deviation = np.zeros(int(group.max()) + 1)
    solution = replace(fitted.solution, shared=_shared(fitted, fitted.solution, group, spread, deviation))
    for number in range(ROUNDS):
        before = spread
        values, deviation, spread = _round(fitted, solution, before)
        steer = np.asarray(logged.steps.steer_rad) + deviation[group][logged.run]
        model = replace(model, recording=logged.with_steering(steer))
        if number < NOISE_ROUNDS:
            solution = solve(model, parameters, values, solution.scales, rounds=1)
        else:
            solution = replace(solution, values=values, prediction=model.predict(values))
        solution = replace(solution, shared=_shared(fitted, solution, group, spread, deviation))
    uncertainty = clustered(solution, parameters, model.recording, model.segments)
    solution = replace(solution, converged=fitted.solution.converged and abs(spread - before) < SETTLED * spread)
    return replace(fitted, model=model, solution=solution, uncertainty=uncertainty, zero_spread_rad=spread)


def _shared(fitted: Fitted, solution: Solution, group: IntArray, spread: float, deviation: FloatArray) -> Shared:
    """Return the random effect of the recordings' zeros.

    `solution`: at the deviations; `fitted`: with one zero; `group`: recording of each run; `spread`: standard deviation
    of `deviation`, each recording's zero from the common one, rad.
    """
    zero, scale = map(fitted.parameters.names.index, (STEERING_ZERO, STEERING_SCALE))
    # a deviation is added to the angle before its scale
    by_zero = solution.prediction.jacobian[:, :, zero] * solution.values[scale]
    change = np.einsum("nij,nj->ni", solution.whitener, by_zero * spread)
    return Shared(group[fitted.model.segments.run], change * np.sqrt(solution.weights)[:, None], deviation / spread)


def _round(fitted: Fitted, solution: Solution, spread: float) -> tuple[FloatArray, FloatArray, float]:
    """Return parameters, recordings' deviations and their spread after one linear step.

    `solution`: with its random effect; `spread`: standard deviation of the deviations now, rad.
    """
    free, shared = fitted.parameters.free, solution.shared
    assert shared is not None
    jacobian, residuals = whitened(solution, free)
    step = np.linalg.lstsq(flattened(jacobian), residuals.ravel(), rcond=None)[0]
    plain, left = whitened(replace(solution, shared=None), free)
    left = left - plain @ step
    n_groups, size = len(shared.amount), shared.size
    pull = np.bincount(shared.group, np.sum(shared.change * left, axis=1), minlength=n_groups)
    deviation = spread * (pull + size * shared.amount) / (1.0 + size)
    values = solution.values.copy()
    values[free] += step
    # common zero and scale of the angle are told by the differences of recordings: each takes a degree of freedom
    n_common = len({STEERING_ZERO, STEERING_SCALE} & set(fitted.parameters.free_names))
    known = float(np.sum(np.square(deviation)) / max(n_groups - n_common, 1))
    return values, deviation, float(np.sqrt(known + spread**2 * np.mean(1.0 / (1.0 + size))))
