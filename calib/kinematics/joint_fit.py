"""Joint estimation of all parameters; those that the data leave open stay about nominal and are named.

Delay and steering zero differ between recordings, as random effects; see `docs/geometry.md`.
"""

from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Final

import numpy as np
from scipy.special import chdtrc, stdtrit

from calib.campaign.checks import listed
from calib.campaign.model import Campaign
from calib.campaign.wheels import mecanum_model
from calib.errors import RefusedError
from calib.kinematics import Recording, drives
from calib.kinematics.blunders import CLEARLY_LESS
from calib.kinematics.drives import GYRO_SCALE, NOMINAL_STD, SENSOR, STEERING_SCALE, STEERING_ZERO, Drive, Parameters
from calib.kinematics.model import Model, Segments
from calib.kinematics.solve import DEGREES, Shared, Solution, kernels, planned, solve
from calib.kinematics.uncertainty import Uncertainty, clustered, expected, flattened, whitened
from calib.types import BoolArray, FloatArray, IntArray

#: a direction with more than this part of the prior spread left is not determined
TOLERATED: Final = 0.5
#: a radius further from nominal, relative, is of wrong counts or units: a factor of two, less the tyre
GROSS: Final = 0.45
#: radii over nominal that no unit or count makes: kilometres make a thousandth
NOTHING: Final = 5e-4
#: of two wheels, where data leave it open
MEAN_RADIUS: Final = "mean_radius_m"


def determined(solution: Solution, parameters: Parameters) -> bool:
    """Return whether the whitened Jacobian determines every direction, in units of each parameter's prior spread."""
    free = parameters.free
    jacobian = flattened(whitened(solution, free)[0] * parameters.prior_std[free])
    return bool(np.linalg.svd(jacobian, compute_uv=False)[-1] * TOLERATED >= 1.0)


def left_open(uncertainty: Uncertainty, parameters: Parameters) -> tuple[str, ...]:
    """Return the parameters, and the mean radius, of which data leave more than `TOLERATED` of what was open before.

    Of data alone the mean radius is open where the nominal one is as good.
    """
    names, spread, pull = parameters.free_names, parameters.prior_std[parameters.free], parameters.pull
    before = np.sqrt(np.diag(np.linalg.inv(pull.T @ pull))) if parameters.pulled else np.ones(len(spread))
    rows = [name for name, ratio in zip(names, uncertainty.std / spread / before, strict=True) if ratio > TOLERATED]
    radii = np.array(["radius" in name for name in names])
    nominal, freedom = float(parameters.nominal[parameters.free] @ radii), uncertainty.freedom
    mean = float(np.sqrt(radii @ uncertainty.covariance @ radii)) / max(nominal, 1e-300)
    dof = float(uncertainty.free[radii].min(initial=np.inf)) if freedom is None else freedom.of(radii * 1.0)
    # a standard deviation from hardly any runs is itself unknown: as wide as one that is known
    mean *= float(stdtrit(min(dof, MANY), ONE_SD))
    if radii.sum() > 1 and mean > NOMINAL_STD * (TOLERATED if parameters.pulled else 1.0):
        rows.append(MEAN_RADIUS)
    return tuple(rows)


#: degrees of freedom, as good as any; probability below one standard deviation above the mean
MANY: Final = 1e6
ONE_SD: Final = 0.8413447460685429
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
    #: parameters that the data leave open, with the mean radius
    undetermined: tuple[str, ...]
    #: with steering angles as logged
    logged: Recording
    #: standard deviation of single recordings' steering zeros, corrected in the model's angles; 0: one for all
    zero_spread_rad: float = 0.0

    @property
    def spread(self) -> float:
        """Mean logarithm of the drive parameters' standard deviations beside their prior ones."""
        n_drive = len(self.parameters.items) - len(SENSOR)
        return float(np.mean(np.log(self.uncertainty.apart[:n_drive] / self.parameters.prior_std[:n_drive])))


def drive_of(campaign: Campaign, source: str, recording: Recording) -> Drive:
    """Return the drive with its nominal values, and slopes where loads varied; `source`: one of `WHEEL_COLUMNS`."""
    vehicle, model = campaign.vehicle, campaign.model
    if source == "front":
        return drives.FrontWheel(vehicle.front_radius_m, vehicle.wheelbase_m)
    if source == "shaft":
        least_mps2 = drives.SLIPS_MPS2 if recording.continuous else drives.SLIPS_AT_ENDS_MPS2
        return drives.rear_shaft(vehicle.wheel_radius_m, vehicle.wheelbase_m, recording.steps, least_mps2)
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
    """Estimate, and name what is not determined; see `Fitted`.

    `sensor`: its pose and delay, too; `start`: to begin from; `known` (4,): noise variances of runs not driven yet.
    """
    free, never = [item.name for item in drive.parameters], tuple[str, ...]()
    first_scales = drives.first_scales(campaign.reference)
    if segments.gyro.any():
        free.append(GYRO_SCALE)
    if sensor:
        # a chord tells no yaw, coarse samples tell no delay
        coarse = float(np.median(np.diff(recording.t_s))) > LONGEST_STEP_S
        never = (*SENSOR[3:4] * segments.chords_alone, *SENSOR[4:] * coarse)
        free += [name for name in SENSOR[1:] if name not in never]
    items, model = drives.parameters_of(drive, campaign.reference), Model(drive, recording, segments)
    radii, alone = [at for at, name in enumerate(free) if "radius" in name], np.array([item.nominal for item in items])
    # nominal values pull only where data leave something open
    attempts = [Parameters.of(items, free), replace(Parameters.of(items, free), pulled=True)]
    for parameters in attempts:
        values, far = parameters.nominal, None
        if start is not None and start.parameters.pulled == parameters.pulled:
            values = np.where(parameters.free, start.solution.values, values)
        elif parameters.pulled and np.any(np.abs(alone[radii] / values[radii] - 1.0) > GROSS):
            far = alone  # wrong counts or units: nominal lengths are no start
        if known is None:
            solution = solve(model, parameters, values, first_scales)
            if far is not None:
                other, whitener = solve(model, parameters, far, first_scales), solution.whitener
                left = (np.einsum("nij,nj->ni", whitener, one.prediction.residuals) for one in (solution, other))
                near, off = (float(np.square(part).sum()) for part in left)
                solution = other if off < CLEARLY_LESS * near else solution
        else:
            solution = planned(model, parameters, values, known)
        # paths that should close and do not, close at no scale
        shrunk = bool((np.abs(solution.values[radii]) < NOTHING * parameters.nominal[radii]).all())
        alone = parameters.nominal if shrunk else solution.values
        if not parameters.pulled and (shrunk or not determined(solution, parameters)):
            continue
        if known is None:
            uncertainty = clustered(solution, parameters, recording, segments)
        else:
            uncertainty = expected(solution, parameters.free, segments.run)
        undetermined = left_open(uncertainty, parameters)
        something = set(free) - set(undetermined) or (len(radii) > 1 and MEAN_RADIUS not in undetermined)
        # noise of the counts alone makes what straights leave open, such as the track, too large
        beyond = np.abs(solution.values - parameters.nominal) > 2.0 * parameters.prior_std
        beyond &= np.isin(parameters.names, undetermined)
        if parameters.pulled and something and beyond.any():
            never = (*never, *compress(parameters.names, beyond))
            attempts.append(replace(parameters, free=parameters.free & ~beyond))
        elif not undetermined or (parameters.pulled and something):
            return Fitted(model, parameters, solution, uncertainty, (*undetermined, *never), recording)
    raise RefusedError(
        f"geometry of {campaign.name!r}: found nothing that these runs determine; expected runs with turns and "
        "straights and a reference of their end poses; drive squares both ways"
    )


#: of taking one delay for several
CHANCE: Final = 0.001
#: how far from the common delay one is sought, and in how many steps
TRIED: Final = 51
OFFSETS_S: Final = np.linspace(-0.5, 0.5, TRIED)
#: gain of log likelihood that another common delay begins at: three standard deviations
CLEARLY_LIKELIER: Final = 4.5
#: for a recording's own delay
FEWEST_BLOCKS: Final = 4


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of the reference's stamps in one session, or run of a single session."""

    label: str = field(metadata={"json": "recording"})
    value_s: float = field(metadata={"json": "value"})
    std_s: float = field(metadata={"json": "sd"})


def at_best_delay(fitted: Fitted, losses: FloatArray) -> Fitted | None:
    """Return a start at the common delay that leaves clearly less, by `delay_losses`; None where the fit's does.

    Of runs that begin on the move no gradient leads there.
    """
    total = losses.sum(axis=1)
    if not total.size or total.min() > total[TRIED // 2] - CLEARLY_LIKELIER:
        return None
    values = fitted.solution.values.copy()
    values[-1] += OFFSETS_S[np.argmin(total)]
    return replace(fitted, solution=replace(fitted.solution, values=values))


def delay_losses(fitted: Fitted) -> FloatArray:
    """Return each recording's negative log likelihood at delays about the common one, shape (TRIED, n_groups).

    Empty where the delay is not estimated.
    """
    model, solution, group = fitted.model, fitted.solution, fitted.model.recording.group
    if not fitted.parameters.free[-1] or SENSOR[-1] in fitted.undetermined:
        return np.zeros((0, 1))
    delay, size, losses = np.eye(len(solution.values))[-1], model.segments.seen.sum(axis=1), []
    for offset in OFFSETS_S:
        late = model.predict(solution.values + offset * delay, path=solution.prediction.path, by_drive=False)
        white = np.einsum("nij,nj->ni", solution.whitener, late.residuals)
        loss = 0.5 * (DEGREES + size) * np.log1p(np.square(white).sum(axis=1) / DEGREES)
        losses.append(np.bincount(group[model.segments.run], loss, minlength=group.max() + 1))
    return np.array(losses)


def sought_delays(fitted: Fitted, losses: FloatArray) -> FloatArray:
    """Return each run's delay from the common one, shape (n_runs,), by `delay_losses`; zero where that fits best."""
    nothing, group = fitted.model.recording.delay_added_s, fitted.model.recording.group
    if not group.any() or not losses.size:
        return nothing
    best = OFFSETS_S[np.argmin(losses, axis=0)]
    return nothing if np.ptp(best) < 1.5 * (OFFSETS_S[1] - OFFSETS_S[0]) else nothing + best[group]


def parted(fitted: Fitted, used: BoolArray) -> tuple[str, list[str]]:
    """Return the parameter that differs most between two groups of runs (k-means), and where it is less and more."""
    jacobian, white = (part[used] for part in whitened(fitted.solution, fitted.parameters.free))
    number = fitted.model.segments.run[used]
    runs = np.unique(number)
    each = [(flattened(jacobian[number == run]), white[number == run].ravel()) for run in runs]
    normal, pull = np.array([part.T @ part for part, _ in each]), np.array([part.T @ own for part, own in each])
    alone = np.square(pull) / np.maximum(np.einsum("nii->ni", normal), 1e-300)
    less = pull[:, int(np.argmax(alone.sum(axis=0)))] < 0.0
    for _ in runs:
        inverse = [np.linalg.pinv(normal[side].sum(axis=0)) for side in (less, ~less)]
        step = [part @ pull[side].sum(axis=0) for part, side in zip(inverse, (less, ~less), strict=True)]
        gain = np.diff([one @ (normal @ one - 2.0 * pull).T for one in step], axis=0)[0]
        less = gain > 0.0
    apart = (step[1] - step[0]) / np.sqrt(np.diag(sum(inverse)))
    most = int(np.argmax(np.abs(apart)))
    gain, run_id = gain * np.sign(apart[most]), fitted.model.recording.run_id[runs]
    sides = [listed(run_id[side * gain > 2.0 * CLEARLY_LIKELIER]) for side in (1.0, -1.0)]
    return fitted.parameters.free_names[most], sides


def own_delays(fitted: Fitted) -> tuple[tuple[Delay, ...], FloatArray]:
    """Return each recording's delay, and what runs add to the common one, (n_runs,); neither where one fits all."""
    recording, common = fitted.model.recording, float(fitted.solution.values[-1])
    if (shifts := _shifts_of(fitted, "delay_s")) is None:
        return (), np.zeros(0)
    group, shift, std = shifts
    added = recording.delay_added_s + shift[group]
    first = np.unique(group, return_index=True)[1]
    if not _disagree(added[first], std):
        return (), np.zeros(0)
    values, labels = (common + added).tolist(), recording.labels.tolist()
    return tuple(Delay(labels[at], values[at], float(std[group[at]])) for at in sorted(first)), added


def _shifts_of(fitted: Fitted, name: str) -> tuple[IntArray, FloatArray, FloatArray] | None:
    # the group of each run (n_runs,), and each group's shift with its standard deviation (n_groups,)
    segments, parameters, group = fitted.model.segments, fitted.parameters, fitted.model.recording.group
    if name not in parameters.free_names or name in fitted.undetermined or not group.any():
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
    about = score - shift[of_block] * information
    return group, shift, np.sqrt(np.bincount(of_block, np.square(about))) / size


def steering_zero_spread_rad(fitted: Fitted) -> float:
    """Return the steering zero's standard deviation between recordings; 0 where they agree."""
    if (shifts := _shifts_of(fitted, STEERING_ZERO)) is None or not _disagree(*shifts[1:]):
        return 0.0
    _, shift, std = shifts
    return float(np.sqrt(max(float(np.var(shift, ddof=1)) - float(np.mean(np.square(std))), 0.0)))


def _disagree(shift: FloatArray, std: FloatArray) -> bool:
    weight = 1.0 / np.square(std)
    mean = float(np.sum(weight * shift) / np.sum(weight))
    return bool(chdtrc(len(shift) - 1.0, float(np.sum(weight * np.square(shift - mean)))) < CHANCE)


#: rounds; the spread of eight recordings is settled to 0.1 % after five
ROUNDS: Final = 8
#: of these, with the noise estimated again
NOISE_ROUNDS: Final = 4
#: last change of the spread, relative
SETTLED: Final = 0.01


def with_own_zeros(fitted: Fitted) -> Fitted:
    """Return the fit with a steering zero for each recording, in its model's angles; itself where one suits all."""
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
    undetermined = left_open(uncertainty, parameters)
    fitted = replace(fitted, model=model, solution=solution, uncertainty=uncertainty, undetermined=undetermined)
    return replace(fitted, zero_spread_rad=spread)


def _shared(fitted: Fitted, solution: Solution, group: IntArray, spread: float, deviation: FloatArray) -> Shared:
    zero, scale = map(fitted.parameters.names.index, (STEERING_ZERO, STEERING_SCALE))
    by_zero = solution.prediction.jacobian[:, :, zero] * solution.values[scale]
    change = np.einsum("nij,nj->ni", solution.whitener, by_zero * spread)
    return Shared(group[fitted.model.segments.run], change * np.sqrt(solution.weights)[:, None], deviation / spread)


def _round(fitted: Fitted, solution: Solution, spread: float) -> tuple[FloatArray, FloatArray, float]:
    free, shared = fitted.parameters.free, solution.shared
    assert shared is not None
    jacobian, residuals = whitened(solution, free)
    flat, off = flattened(jacobian), (fitted.parameters.nominal - solution.values)[free]
    normal = flat.T @ flat + solution.pull
    step = np.linalg.lstsq(normal, flat.T @ residuals.ravel() + solution.pull @ off, rcond=None)[0]
    plain, left = whitened(replace(solution, shared=None), free)
    left = left - plain @ step
    n_groups, size = len(shared.amount), shared.size
    pull = np.bincount(shared.group, np.sum(shared.change * left, axis=1), minlength=n_groups)
    deviation = spread * (pull + size * shared.amount) / (1.0 + size)
    values = solution.values.copy()
    values[free] += step
    # common zero and scale take a degree of freedom each
    n_common = len({STEERING_ZERO, STEERING_SCALE} & set(fitted.parameters.free_names))
    known = float(np.sum(np.square(deviation)) / max(n_groups - n_common, 1))
    return values, deviation, float(np.sqrt(known + spread**2 * np.mean(1.0 / (1.0 + size))))


def noise_by_windows(fitted: Fitted, whole: Model) -> tuple[float, float]:
    """Return the noise of whole runs, in m and rad, by that of windows; infinite where none were used."""
    if len(fitted.model.segments) <= len(whole.segments):
        return np.inf, np.inf
    values, scales = fitted.solution.values, fitted.solution.scales
    body, path = whole.motion(values).body, whole.predict(values).path
    variances = np.einsum("knii->kni", kernels(path, body, whole.segments, float(values[-2])))
    end = np.tensordot(scales, variances, 1).mean(axis=0)
    return float(np.sqrt(end[:2].sum())), float(np.sqrt(end[2]))
