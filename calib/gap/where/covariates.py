"""Where the gap lies: by channel, by covariate, by run, and inside the runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, IntArray, StrArray
from calib.campaign.model import Campaign
from calib.gap.data.channels import N_CHANNELS, Channel
from calib.gap.data.observations import Observations
from calib.gap.effects.covariate import covariate_columns
from calib.gap.effects.shapes import driven_speed_mps
from calib.gap.evidence.marginal import CALIBRATION_SD, rows
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path
from calib.gap.where.along_run import find_places
from calib.gap.where.result import ChannelGap, CovariateLine, PlaceLine, RunLine, Where

__all__ = ["FALSE_FINDING", "covariate_values", "locate"]

#: chance of any false finding over the whole table
FALSE_FINDING: Final = 0.05
BOOTSTRAPS: Final = 300
MOST_RUNS: Final = 8
FEWEST_UNITS: Final = 6
#: turns and lengths that differ by less are noise of the wheels themselves, which the gap shares
LEAST_TURN_RAD: Final = 0.3
LEAST_LENGTH: Final = 0.05


def locate(
    observations: Observations,
    nominal: Path,
    noise: Noise,
    gap: FloatArray,
    *,
    rng: np.random.Generator,
    campaign: Campaign | None = None,
) -> Where:
    """Say where the gap lies.

    Every covariate is tested in every channel by an F test of the gap over its floor; the smallest p of a covariate is
    multiplied by the channels looked at, and the table is held to one chance in twenty of any false finding by Holm's
    steps. Shares come with bootstrap intervals over units.

    Parameters
    ----------
    observations : Observations
        What was driven.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    gap : array of float, shape (n_units, n_channels)
        Measured minus simulated; 0 where a unit lacks the channel.
    rng : numpy.random.Generator
        For the bootstrap.
    campaign : Campaign, optional
        The same runs with their logs: without it, no places inside runs.

    Returns
    -------
    Where
    """
    lines = _by_wheel(observations, nominal, noise, gap, rng)
    weights = rng.multinomial(
        len(observations), np.full(len(observations), 1.0 / len(observations)), BOOTSTRAPS
    ).astype(np.float64)
    scaled = np.where(observations.usable, gap / noise.floor, np.nan)
    for name, values in covariate_values(observations).items():
        line = _tested(name, values, scaled, weights, max(noise.dof, 3.0))
        if line is not None:
            lines.append(line)
    places: tuple[PlaceLine, ...] = ()
    notes: tuple[str, ...] = ("no logs were given: nothing can be said of places inside the runs",)
    if campaign is not None:
        places, notes = find_places(campaign, observations, rng)
    return Where(
        channels=_by_channel(observations, noise, gap),
        covariates=_held_to_one_error(lines),
        runs=_by_run(observations, noise, gap),
        places=places,
        notes=notes,
    )


def covariate_values(observations: Observations) -> dict[str, FloatArray | StrArray]:
    """Return what the gap may depend on, by name, each shape (n_units,): numbers, or labels as text.

    Missing numbers are NaN, missing labels empty. Only what varies is listed.
    """
    load_left, load_right = observations.number("load_left_N"), observations.number("load_right_N")
    by_wheels = observations.total(observations.turn_rad)
    # by the reference where there is one: the wheels' own turn shares the gap's errors
    turn = np.where(observations.usable[:, Channel.HEADING], observations.measured[:, Channel.HEADING], by_wheels)
    speed = observations.number("speed_mps")
    values: dict[str, FloatArray | StrArray] = {
        "route": observations.labels["kind"],
        "session": observations.labels["session"],
        "direction": observations.labels["direction"],
        "payload_kg": observations.number("payload_kg"),
        "load_left_N": load_left,
        "load_right_N": load_right,
        "load_sum_N": load_left + load_right,
        "load_difference_N": load_right - load_left,
        "speed_mps": speed if np.isfinite(speed).any() else driven_speed_mps(observations),
        "temperature_C": observations.number("temperature_C"),
        "minutes_under_load": observations.number("minutes_under_load"),
        "travelled_km": observations.number("travelled_km"),
    }
    if np.ptp(turn) > LEAST_TURN_RAD:
        values["turn"] = turn
        values["turn_absolute"] = np.maximum(
            observations.total(np.abs(observations.turn_rad)) - np.abs(by_wheels - turn), 0.0
        )
    if np.ptp(observations.length_m) > LEAST_LENGTH * float(np.max(observations.length_m)):
        values["length_m"] = observations.length_m
    for name in ("amplitude_m", "wavelength_m", *covariate_columns(observations)):
        values[name] = observations.number(name)
    return {name: column for name, column in values.items() if _varied(column)}


def _varied(values: FloatArray | StrArray) -> bool:
    if values.dtype.kind == "f":
        known = values[np.isfinite(values)]
        return len(known) >= FEWEST_UNITS and float(np.ptp(known)) > 1e-9 * max(float(np.abs(known).max()), 1e-9)
    return len(np.unique(values[values != ""])) > 1


def _by_channel(observations: Observations, noise: Noise, gap: FloatArray) -> tuple[ChannelGap, ...]:
    gaps = []
    for channel in Channel:
        on = observations.usable[:, channel]
        if on.any():
            gaps.append(
                ChannelGap(
                    channel=channel,
                    rms=float(np.sqrt(np.mean(gap[on, channel] ** 2))),
                    floor=float(np.sqrt(np.mean(noise.floor[on, channel] ** 2))),
                    mean=float(np.mean(gap[on, channel])),
                    n_units=int(on.sum()),
                )
            )
    return tuple(gaps)


def _by_run(observations: Observations, noise: Noise, gap: FloatArray) -> tuple[RunLine, ...]:
    """Return the units that deviate most, each in the channel where it does."""
    z = np.where(observations.usable, gap / noise.floor, 0.0)
    worst = np.abs(z).argmax(axis=1)
    size = np.abs(z)[np.arange(len(observations)), worst]
    return tuple(
        RunLine(
            run_id=str(observations.labels["run_id"][unit]),
            channel=Channel(int(worst[unit])),
            value=float(gap[unit, worst[unit]]),
            floor=float(noise.floor[unit, worst[unit]]),
            z=float(z[unit, worst[unit]]),
        )
        for unit in np.argsort(-size, kind="stable")[:MOST_RUNS]
    )


def _held_to_one_error(lines: list[CovariateLine]) -> tuple[CovariateLine, ...]:
    """Return the table, smallest p first, each line held to the table's chance of any false one by Holm's steps.

    By hand: statsmodels has the same steps, but its import takes longer than all that is done here.
    """
    ordered = sorted(lines, key=lambda line: (line.p_value, -line.share))
    stepped = [line.p_value * (len(ordered) - number) for number, line in enumerate(ordered)]
    stands = np.maximum.accumulate(stepped) <= FALSE_FINDING
    return tuple(
        replace(line, significant=bool(significant)) for line, significant in zip(ordered, stands, strict=True)
    )


def _tested(
    name: str, values: FloatArray | StrArray, scaled: FloatArray, weights: FloatArray, most_dof: float
) -> CovariateLine | None:
    """Test a covariate in every channel; None where no channel allows it."""
    best: tuple[float, Channel, _Fit] | None = None
    tried = 0
    for channel in Channel:
        fit = _Fit.of(values, scaled[:, channel])
        if fit is None:
            continue
        tried += 1
        p = fit.p_value(most_dof)
        if best is None or p < best[0]:
            best = (p, channel, fit)
    if best is None:
        return None
    p, channel, fit = best
    shares = fit.shares(weights[:, fit.on])
    return CovariateLine(
        name=name,
        channel=channel,
        share=fit.share(),
        ci95=_interval(shares),
        p_value=float(min(1.0, p * tried)),
        significant=False,
        n_units=int(fit.on.sum()),
    )


def _interval(shares: FloatArray) -> tuple[float, float] | None:
    known = shares[np.isfinite(shares)]
    if len(known) < 0.5 * len(shares):
        return None
    return float(np.quantile(known, 0.025)), float(np.quantile(known, 0.975))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """One channel's gap over its floor, y, against one covariate."""

    on: npt.NDArray[np.bool_]
    y: FloatArray
    x: FloatArray | None
    group: IntArray | None

    @staticmethod
    def of(values: FloatArray | StrArray, y: FloatArray) -> _Fit | None:
        if values.dtype.kind == "f":
            on = np.isfinite(y) & np.isfinite(values)
            x = np.asarray(values[on], dtype=np.float64)
            if on.sum() < FEWEST_UNITS or np.ptp(x) <= 1e-9 * max(float(np.abs(x).max()), 1e-9):
                return None
            return _Fit(on, y[on], (x - x.mean()) / np.std(x), None)
        on = np.isfinite(y) & (values != "")
        names, group = np.unique(values[on], return_inverse=True)
        if len(names) < 2 or on.sum() < max(FEWEST_UNITS, 2 * len(names)):
            return None
        return _Fit(on, y[on], None, np.asarray(group, dtype=np.int64))

    @property
    def df(self) -> int:
        """Degrees of freedom of the covariate."""
        return 1 if self.group is None else int(self.group.max())

    def squares(self, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (about the mean, explained, units) for weights (n_draws, n), each shape (n_draws,)."""
        n = weight.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = weight @ self.y / n
            total = weight @ self.y**2 - n * mean**2
            if self.group is None:
                assert self.x is not None
                mean_x = weight @ self.x / n
                cross = weight @ (self.x * self.y) - n * mean * mean_x
                explained = cross**2 / (weight @ self.x**2 - n * mean_x**2)
            else:
                member = (self.group[:, None] == np.arange(self.df + 1)).astype(np.float64)
                size, summed = weight @ member, weight @ (member * self.y[:, None])
                explained = np.where(size > 0, summed**2 / size, 0.0).sum(axis=1) - n * mean**2
        return total, explained, n

    def p_value(self, most_dof: float) -> float:
        """Return the p of an F test, the residual taken as no smaller than the floor and known no better than that."""
        from scipy.special import fdtrc

        total, explained, n = (float(part[0]) for part in self.squares(np.ones((1, len(self.y)))))
        dof = n - self.df - 1.0
        residual = max((total - explained) / dof, 1.0)
        return float(fdtrc(self.df, min(dof, most_dof), max(explained, 0.0) / self.df / residual))

    def shares(self, weight: FloatArray) -> FloatArray:
        """Return the share of the variance beyond the floor that the covariate explains, for weights (n_draws, n)."""
        total, explained, n = self.squares(weight)
        with np.errstate(divide="ignore", invalid="ignore"):
            residual = np.maximum((total - explained) / np.maximum(n - self.df - 1.0, 1.0), 1.0)
            beyond = total - (n - 1.0)
            share = np.where(beyond > 0, (explained - self.df * residual) / beyond, 0.0)
        return np.asarray(np.clip(share, 0.0, 1.0))

    def share(self) -> float:
        """Return the share itself."""
        return float(self.shares(np.ones((1, len(self.y))))[0])


def _by_wheel(
    observations: Observations, nominal: Path, noise: Noise, gap: FloatArray, rng: np.random.Generator
) -> list[CovariateLine]:
    """Return what the left wheel's and the right wheel's travel explain, each beside the other."""
    from scipy.special import fdtrc

    columns = np.concatenate([nominal.calibration[:, :, :2] * CALIBRATION_SD[:2], gap[:, :, None]], axis=2)
    white = rows(nominal, noise, columns)
    unit = np.repeat(np.arange(len(observations))[:, None], N_CHANNELS, axis=1)[observations.usable]
    if len(white) < FEWEST_UNITS:
        return []
    products = np.zeros((len(observations), 3, 3))
    np.add.at(products, unit, white[:, :, None] * white[:, None, :])
    whole = products.sum(axis=0)
    norm = np.sqrt(np.diag(whole)[:2])
    if not (norm > 0).all() or abs(whole[0, 1]) > 0.9999 * norm[0] * norm[1]:
        return []
    sizes = observations.usable.sum(axis=1).astype(np.float64)
    draws = rng.multinomial(len(observations), np.full(len(observations), 1.0 / len(observations)), BOOTSTRAPS).astype(
        np.float64
    )
    lines = []
    for wheel, name in enumerate(("left wheel", "right wheel")):
        explained, rest = _beside(whole[None], wheel)
        n = float(sizes.sum())
        residual = max(float(rest[0]) / max(n - 2.0, 1.0), 1.0)
        # without an intercept the test leans on the floor's own scale, known no better than repeats know it
        p = float(fdtrc(1.0, float(np.clip(noise.dof, 3.0, max(n - 2.0, 3.0))), float(explained[0]) / residual))

        def share(moments: FloatArray, count: FloatArray, wheel: int = wheel) -> FloatArray:
            explained, rest = _beside(moments, wheel)
            variance = np.maximum(rest / np.maximum(count - 2.0, 1.0), 1.0)
            beyond = moments[:, 2, 2] - count
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.clip(np.where(beyond > 0, (explained - variance) / beyond, 0.0), 0.0, 1.0)

        ci95 = _interval(share(np.tensordot(draws, products, axes=1), draws @ sizes))
        share_of_all = float(share(whole[None], np.array([n]))[0])
        lines.append(CovariateLine(name, None, share_of_all, ci95, p, significant=False, n_units=len(observations)))
    return lines


def _beside(moments: FloatArray, wheel: int) -> tuple[FloatArray, FloatArray]:
    """Return what a wheel explains beside the other, and what both leave, of moments (n, 3, 3), each shape (n,)."""
    other = 1 - wheel
    with np.errstate(all="ignore"):
        ratio = moments[:, wheel, other] / moments[:, other, other]
        own = moments[:, wheel, wheel] - ratio * moments[:, other, wheel]
        right = moments[:, wheel, 2] - ratio * moments[:, other, 2]
        by_other = moments[:, other, 2] ** 2 / moments[:, other, other]
        explained = np.nan_to_num(right**2 / own)
    return explained, np.maximum(moments[:, 2, 2] - by_other - explained, 0.0)
