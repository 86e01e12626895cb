"""References without motion capture: turns by a gyro, its bias from standstills, and closed loops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.campaign.model import Border, Campaign, RunTable
from calib.campaign.wheels import WHEEL_COLUMNS, odometry_source, on_one_axle, without_rear_wheels
from calib.errors import CalibError
from calib.types import FloatArray

GYRO: Final = "gyro_z_radps"
#: turn of a run by the gyro, and its standard uncertainty without that of the gyro's scale
GYRO_TURN: Final = "gyro_theta_rad"
GYRO_SIGMA: Final = "gyro_sigma_rad"
#: a vehicle turns before the first count and rocks after the last one
SETTLING_S: Final = 0.1
#: label of a run that ends on the mark where it began
CLOSED: Final = "closed"
#: a standstill lasts so long at least: samples enough for a bias
STANDSTILL_S: Final = 0.5
#: a closed loop whose wheels turn the vehicle by this much more or less than whole turns is doubtful
WHOLE_TURN_RAD: Final = 0.8


@dataclass(frozen=True, slots=True)
class Bias:
    """What a gyro reads at rest."""

    radps: float
    #: standard deviation of one sample, and samples at rest
    sample_std_radps: float
    samples: int

    @property
    def std_radps(self) -> float:
        """Standard uncertainty of the bias."""
        return self.sample_std_radps / float(np.sqrt(max(self.samples, 1)))


def with_references(campaign: Campaign, shown: str, border: Border) -> Campaign:
    """Return the campaign with the turns by a gyro, and the end poses of closed loops, in its run table.

    `shown` is the name of its run table in messages; `border` takes what was done.
    """
    if GYRO in campaign.logs.columns:
        campaign = _with_gyro(campaign, shown, border)
    if (campaign.runs.label("loop") == CLOSED).any():
        campaign = _with_closed_loops(campaign, shown, border)
    return campaign


def _with_gyro(campaign: Campaign, shown: str, border: Border) -> Campaign:
    """Return the campaign with the column `GYRO_TURN` and its uncertainty, where the table lacks them."""
    runs, logs = campaign.runs, campaign.logs
    turn, sigma = runs.number(GYRO_TURN).copy(), runs.number(GYRO_SIGMA).copy()
    own = {int(run): bias_of(campaign, int(run)) for run in np.flatnonzero(logs.present)}
    known = {run: bias for run, bias in own.items() if bias is not None}
    measured = [run for run in own if np.isfinite(logs.of(run).get(GYRO, np.full(1, np.nan))).all()]
    without = [run for run in measured if run not in known]
    if measured and not known:
        text = (
            f"found no standstill of {STANDSTILL_S:g} s in any log, so that the gyro's bias is unknown and the gyro "
            "not used; expected the vehicle at rest at the start or end of a run"
        )
        border.say(f"logs, column {GYRO}", text, "gyro_bias", level="suspicious")
        return campaign
    sessions = runs.label("session")
    # a bias wanders from run to run: what it scatters by counts where a run has no standstill of its own
    wander = float(np.std([bias.radps for bias in known.values()], ddof=1)) if len(known) > 1 else 0.0
    for run in measured:
        bias, more = known.get(run), 0.0
        if bias is None:
            alike = [one for other, one in known.items() if sessions[other] == sessions[run]] or list(known.values())
            mean = float(np.mean([one.radps for one in alike]))
            bias, more = replace(alike[0], radps=mean), wander
        if np.isnan(turn[run]):
            turn[run], sigma[run] = _turn(logs.of(run), bias, more)
    text = f"{len(measured)} run(s) integrated from the log's {GYRO}, less the bias at rest"
    if without:
        text += f"; {len(without)} without a standstill of their own, less that of their session"
    border.say(f"{shown}, column {GYRO_TURN}", text, "gyro")
    return replace(campaign, runs=_with_numbers(runs, {GYRO_TURN: turn, GYRO_SIGMA: sigma}))


def bias_of(campaign: Campaign, run: int) -> Bias | None:
    """Return what the gyro of a run reads while no wheel counts; None without a standstill of `STANDSTILL_S`."""
    log = campaign.logs.of(run)
    source = odometry_source(campaign) if without_rear_wheels(campaign) else "rear"
    wheels = [log[name] for name in WHEEL_COLUMNS[source] if name in log]
    if GYRO not in log or not wheels:
        return None
    t_s, rate = log["t_s"], log[GYRO]
    moves = np.any([np.diff(wheel) != 0.0 for wheel in wheels], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate(([True], moves, [True])).astype(np.int8)))
    at_rest = np.zeros(len(t_s), dtype=np.bool_)
    for first, last in edges.reshape(-1, 2):
        begin, end = t_s[first] + SETTLING_S, t_s[last] - SETTLING_S
        if end - begin >= STANDSTILL_S:
            at_rest |= (t_s >= begin) & (t_s <= end)
    values = rate[at_rest & np.isfinite(rate)]
    if len(values) < 3:
        return None
    return Bias(float(values.mean()), float(values.std(ddof=1)), len(values))


def _turn(log: dict[str, FloatArray], bias: Bias, more_radps: float) -> tuple[float, float]:
    """Return the turn of a run and its standard uncertainty: of the samples' noise, and of the bias over the run."""
    t_s, rate = log["t_s"], log[GYRO] - bias.radps
    duration = t_s[-1] - t_s[0]
    noise = bias.sample_std_radps * np.linalg.norm(np.diff(t_s))
    sigma = np.hypot(noise, np.hypot(bias.std_radps, more_radps) * duration)
    return float(np.trapezoid(rate, t_s)), float(sigma)


def _with_closed_loops(campaign: Campaign, shown: str, border: Border) -> Campaign:
    """Return the campaign in which closed loops end at (0, 0) and whole turns, where the table has no end pose."""
    runs = campaign.runs
    if campaign.reference.frame == "map":
        text = 'found closed loops with [reference] frame = "map"; expected "start", in which they end at 0; not used'
        border.say(f"{shown}, column loop", text, "closed_loop", level="suspicious")
        return campaign
    closed = runs.label("loop") == CLOSED
    wheels = _turn_by_wheels(campaign)
    whole = 2.0 * np.pi * np.rint(wheels / (2.0 * np.pi))
    ends = {"ref_x_m": np.zeros(len(runs)), "ref_y_m": np.zeros(len(runs)), "ref_theta_rad": whole}
    empty = closed & np.isfinite(wheels) & np.isnan([runs.number(name) for name in ends]).all(axis=0)
    for run in np.flatnonzero(empty & (np.abs(wheels - whole) > WHOLE_TURN_RAD)):
        text = (
            f"the wheels turn the closed loop by {wheels[run]:.3g} rad, which is no whole turn; expected the vehicle "
            "to end on the mark where it began, heading as it did; check the run"
        )
        where = f"{shown}, row {runs.line[run]}, column loop"
        border.say(where, text, "closed_loop", level="suspicious", run_id=str(runs.run_id[run]))
    filled = {name: np.where(empty, value, runs.number(name)) for name, value in ends.items()}
    text = f"{int(empty.sum())} closed loop(s) end at x = y = 0 and whole turns"
    border.say(f"{shown}, column loop", text, "closed_loop")
    return replace(campaign, runs=_with_numbers(runs, filled))


def _turn_by_wheels(campaign: Campaign) -> FloatArray:
    """Return the turn of each run by the nominal vehicle, shape (n_runs,); NaN without counts."""
    try:
        axle = on_one_axle(campaign)
    except CalibError:
        return np.full(len(campaign.runs), np.nan)
    model, encoder = axle.model, axle.encoder
    left = axle.runs.number("counts_left") / encoder.counts_per_rev_left * model.radius_left_m
    right = axle.runs.number("counts_right") / encoder.counts_per_rev_right * model.radius_right_m
    return np.asarray(2.0 * np.pi * (right - left) / model.track_m)


def _with_numbers(runs: RunTable, numbers: dict[str, FloatArray]) -> RunTable:
    return replace(runs, numbers={**runs.numbers, **numbers})
