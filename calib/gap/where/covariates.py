"""Where the gap lies: by channel, by covariate, by run, and inside the runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, IntArray, StrArray
from calib.campaign.model import Campaign
from calib.gap.data.observations import CHANNELS, Observations
from calib.gap.effects.covariate import covariate_columns
from calib.gap.effects.shapes import driven_speed_mps
from calib.gap.evidence.marginal import CALIBRATION_SD, rows
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path
from calib.gap.where.along_run import find_places

__all__ = ["FALSE_FINDING", "covariate_values", "locate"]

#: chance of any false finding over the whole table
FALSE_FINDING: Final = 0.05
BOOTSTRAPS: Final = 300
MOST_RUNS: Final = 8
FEWEST_UNITS: Final = 6
#: turns and lengths that differ by less are noise of the wheels themselves, which the gap shares
LEAST_TURN_RAD: Final = 0.3
LEAST_LENGTH: Final = 0.05


@dataclass(frozen=True, slots=True)
class _Finding:
    """What one covariate showed in its main channel."""

    name: str
    channel: str
    share: float
    ci95: tuple[float, float] | None
    p_value: float
    n_units: int


def locate(
    s: Observations,
    nominal: Path,
    noise: Noise,
    gap: FloatArray,
    *,
    rng: np.random.Generator,
    campaign: Campaign | None = None,
) -> dict[str, Any]:
    """Say where the gap lies.

    Every covariate is tested in every channel by an F test of the gap over its floor; the smallest p of a covariate is
    multiplied by the channels looked at, and the table is held to one chance in twenty of any false finding by Holm's
    steps. Shares come with bootstrap intervals over units.

    Parameters
    ----------
    s : Observations
        What was driven.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    gap : array of float, shape (n_units, 6)
        Measured minus simulated; 0 where a unit lacks the channel.
    rng : numpy.random.Generator
        For the bootstrap.
    campaign : Campaign, optional
        The same runs with their logs: without it, no places inside runs.

    Returns
    -------
    dict
        ``channels``, ``covariates``, ``runs``, ``places`` and ``notes`` as plain JSON values.
    """
    findings = _by_wheel(s, nominal, noise, gap, rng)
    weights = rng.multinomial(len(s), np.full(len(s), 1.0 / len(s)), BOOTSTRAPS).astype(np.float64)
    scaled = np.where(s.usable, gap / noise.floor, np.nan)
    for name, values in covariate_values(s).items():
        found = _tested(name, values, scaled, weights, max(noise.dof, 3.0))
        if found is not None:
            findings.append(found)
    places: list[dict[str, Any]] = []
    notes = ["no logs were given: nothing can be said of places inside the runs"]
    if campaign is not None:
        places, notes = find_places(campaign, s, rng)
    return {
        "channels": _by_channel(s, noise, gap),
        "covariates": _holm(findings),
        "runs": _by_run(s, noise, gap),
        "places": places,
        "notes": notes,
    }


def covariate_values(s: Observations) -> dict[str, FloatArray | StrArray]:
    """Return what the gap may depend on, by name, each shape (n_units,): numbers, or labels as text.

    Missing numbers are NaN, missing labels empty. Only what varies is listed.
    """
    load_left, load_right = s.number("load_left_N"), s.number("load_right_N")
    by_wheels = s.total(s.turn_rad)
    # by the reference where there is one: the wheels' own turn shares the gap's errors
    turn = np.where(s.usable[:, 3], s.measured[:, 3], by_wheels)
    speed = s.number("speed_mps")
    made: dict[str, FloatArray | StrArray] = {
        "route": s.labels["kind"],
        "session": s.labels["session"],
        "direction": s.labels["direction"],
        "payload_kg": s.number("payload_kg"),
        "load_left_N": load_left,
        "load_right_N": load_right,
        "load_sum_N": load_left + load_right,
        "load_difference_N": load_right - load_left,
        "speed_mps": speed if np.isfinite(speed).any() else driven_speed_mps(s),
        "temperature_C": s.number("temperature_C"),
        "minutes_under_load": s.number("minutes_under_load"),
        "travelled_km": s.number("travelled_km"),
    }
    if np.ptp(turn) > LEAST_TURN_RAD:
        made["turn"] = turn
        made["turn_absolute"] = np.maximum(s.total(np.abs(s.turn_rad)) - np.abs(by_wheels - turn), 0.0)
    if np.ptp(s.length_m) > LEAST_LENGTH * float(np.max(s.length_m)):
        made["length_m"] = s.length_m
    for name in ("amplitude_m", "wavelength_m", *covariate_columns(s)):
        made[name] = s.number(name)
    return {name: values for name, values in made.items() if _varied(values)}


def _varied(values: FloatArray | StrArray) -> bool:
    if values.dtype.kind == "f":
        known = values[np.isfinite(values)]
        return len(known) >= FEWEST_UNITS and float(np.ptp(known)) > 1e-9 * max(float(np.abs(known).max()), 1e-9)
    return len(np.unique(values[values != ""])) > 1


def _by_channel(s: Observations, noise: Noise, gap: FloatArray) -> dict[str, dict[str, Any]]:
    made = {}
    for number, name in enumerate(CHANNELS):
        on = s.usable[:, number]
        if on.any():
            made[name] = {
                "rms": float(np.sqrt(np.mean(gap[on, number] ** 2))),
                "floor": float(np.sqrt(np.mean(noise.floor[on, number] ** 2))),
                "mean": float(np.mean(gap[on, number])),
                "unit": "m" if number in {0, 1, 2, 4} else "rad",
                "n_units": int(on.sum()),
            }
    return made


def _by_run(s: Observations, noise: Noise, gap: FloatArray) -> list[dict[str, Any]]:
    """Return the units that deviate most, each in the channel where it does."""
    z = np.where(s.usable, gap / noise.floor, 0.0)
    worst = np.abs(z).argmax(axis=1)
    size = np.abs(z)[np.arange(len(s)), worst]
    made = []
    for unit in np.argsort(-size, kind="stable")[:MOST_RUNS]:
        channel = int(worst[unit])
        made.append(
            {
                "run_id": str(s.labels["run_id"][unit]),
                "channel": CHANNELS[channel],
                "value": float(gap[unit, channel]),
                "floor": float(noise.floor[unit, channel]),
                "z": float(z[unit, channel]),
            }
        )
    return made


def _holm(findings: list[_Finding]) -> list[dict[str, Any]]:
    """Return the table, smallest p first, with Holm's verdict on each line."""
    ordered = sorted(findings, key=lambda one: (one.p_value, -one.share))
    made: list[dict[str, Any]] = []
    holding = True
    for number, one in enumerate(ordered):
        holding = holding and one.p_value * (len(ordered) - number) <= FALSE_FINDING
        made.append(
            {
                "name": one.name,
                "share": one.share,
                "ci95": None if one.ci95 is None else list(one.ci95),
                "p_value": one.p_value,
                "significant": holding,
                "channel": one.channel,
                "n_units": one.n_units,
            }
        )
    return made


def _tested(
    name: str, values: FloatArray | StrArray, scaled: FloatArray, weights: FloatArray, most_dof: float
) -> _Finding | None:
    """Test a covariate in every channel; None where no channel allows it."""
    best: tuple[float, int, _Fit] | None = None
    tried = 0
    for channel in range(scaled.shape[1]):
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
    return _Finding(
        name,
        CHANNELS[channel],
        fit.share(),
        _interval(shares),
        float(min(1.0, p * tried)),
        int(fit.on.sum()),
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
            made = np.where(beyond > 0, (explained - self.df * residual) / beyond, 0.0)
        return np.asarray(np.clip(made, 0.0, 1.0))

    def share(self) -> float:
        """Return the share itself."""
        return float(self.shares(np.ones((1, len(self.y))))[0])


def _by_wheel(
    s: Observations, nominal: Path, noise: Noise, gap: FloatArray, rng: np.random.Generator
) -> list[_Finding]:
    """Return what the left wheel's and the right wheel's travel explain, each beside the other."""
    from scipy.special import fdtrc

    columns = np.concatenate([nominal.calibration[:, :, :2] * CALIBRATION_SD[:2], gap[:, :, None]], axis=2)
    white = rows(nominal, noise, columns)
    unit = np.repeat(np.arange(len(s))[:, None], 6, axis=1)[s.usable]
    if len(white) < FEWEST_UNITS:
        return []
    products = np.zeros((len(s), 3, 3))
    np.add.at(products, unit, white[:, :, None] * white[:, None, :])
    whole = products.sum(axis=0)
    norm = np.sqrt(np.diag(whole)[:2])
    if not (norm > 0).all() or abs(whole[0, 1]) > 0.9999 * norm[0] * norm[1]:
        return []
    sizes = s.usable.sum(axis=1).astype(np.float64)
    draws = rng.multinomial(len(s), np.full(len(s), 1.0 / len(s)), BOOTSTRAPS).astype(np.float64)
    made = []
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
        made.append(_Finding(name, "all", float(share(whole[None], np.array([n]))[0]), ci95, p, len(s)))
    return made


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
