"""Where the gap lies: by channel, covariate, run, and place inside the runs."""

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.documents import plain_fields
from calib.gap.effects.quantities import covariate_columns, driven_speed_mps
from calib.gap.inference.fit import whitened_rows
from calib.gap.inference.noise import Noise
from calib.gap.localise import BOOTSTRAP_DRAWS, FALSE_FINDING_PROBABILITY, PlaceResult, find_places
from calib.gap.observations import N_CHANNELS, Channel, Observations
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, IntArray, StrArray, floats


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """The gap in one channel."""

    channel: Channel = field(metadata={"json": False})
    #: root mean squares of gap and noise level, in the channel's unit
    rms: float
    floor: float
    mean: float = 0.0
    n_units: int = 0

    @property
    def ratio(self) -> float | None:
        """Gap over noise level; None without a noise level."""
        return self.rms / self.floor if self.floor else None

    def to_dict(self) -> dict[str, Any]:
        """Return the gap as plain JSON values."""
        return plain_fields(self, unit=self.channel.unit)


@dataclass(frozen=True, slots=True)
class RunDeviation:
    """A run that deviates much: gap, floor and their ratio `z`."""

    run_id: str
    channel: Channel
    value: float
    floor: float
    z: float
    #: of a window of a recording
    from_s: float | None = None
    to_s: float | None = None

    @property
    def name(self) -> str:
        """The run, and when in it."""
        if self.from_s is None or self.to_s is None:
            return self.run_id
        return f"{self.run_id}, {self.from_s:.1f} s to {self.to_s:.1f} s"

    def to_dict(self) -> dict[str, Any]:
        """Return the line as plain JSON values."""
        return plain_fields(self, channel=self.channel.label)


ALL_CHANNELS: Final = "all"


@dataclass(frozen=True, slots=True)
class CovariateResult:
    """What the gap correlates with."""

    name: str  #: with its unit suffix; ``left wheel`` and ``right wheel`` for travel
    channel: Channel | None  #: where it shows most; None: all together
    share: float  #: of the variance above the noise level, 0 to 1
    ci95: tuple[float, float] | None  #: bootstrap interval of the share
    p_value: float  #: of no dependence, times the number of channels looked at
    significant: bool  #: at a chance of 5 % of any false line in the table
    n_units: int = 0

    @property
    def channel_label(self) -> str:
        """Name of the channel, ``all`` for all together."""
        return ALL_CHANNELS if self.channel is None else self.channel.label

    def to_dict(self) -> dict[str, Any]:
        """Return the line as plain JSON values."""
        return plain_fields(self, channel=self.channel_label)


@dataclass(frozen=True, slots=True)
class GapLocation:
    """Where a gap lies."""

    channels: tuple[ChannelGap, ...] = ()
    covariates: tuple[CovariateResult, ...] = ()  #: smallest p first
    runs: tuple[RunDeviation, ...] = ()
    places: tuple[PlaceResult, ...] = ()  #: inside the runs, smallest p first
    notes: tuple[str, ...] = ()  #: what these runs cannot be asked
    rest: "GapLocation | None" = None  #: of what the named causes leave

    @property
    def significant(self) -> tuple[CovariateResult, ...]:
        """Covariates that stand."""
        return tuple(line for line in self.covariates if line.significant)

    def channel(self, channel: Channel) -> ChannelGap | None:
        """Return a channel's gap, None if not measured."""
        return next((gap for gap in self.channels if gap.channel is channel), None)

    def to_dict(self) -> dict[str, Any]:
        """Return the location as plain JSON values; ``rest`` if there is one."""
        document = plain_fields(self, channels={gap.channel.label: gap.to_dict() for gap in self.channels})
        if self.rest is None:
            del document["rest"]
        return document


MAX_LISTED_RUNS: Final = 8


def locate(
    nominal: Path,
    noise: Noise,
    gap: FloatArray,
    floor: FloatArray,
    left: FloatArray,
    campaign: Campaign,
    rng: np.random.Generator,
) -> GapLocation:
    """Say where the gap lies, and what its causes leave.

    Holm's steps hold the table to one chance in twenty of any false finding; see `covariate_test`.

    `gap`, `left` (n_units, n_channels): measured minus simulated, 0 where a unit lacks the channel; the same with its
    causes fitted; `floor`: what the gap is shown against; `campaign`: the same runs with their logs.
    """
    observations, lines = nominal.s, _tested(nominal, noise, gap, rng)
    places, notes = find_places(campaign, observations, rng)
    channels, runs = _by_channel(observations, floor, gap), by_run(observations, floor, gap)
    unexplained = GapLocation(covariates=_tested(nominal, noise, left, rng))
    return GapLocation(channels=channels, covariates=lines, runs=runs, places=places, notes=notes, rest=unexplained)


def _tested(nominal: Path, noise: Noise, gap: FloatArray, rng: np.random.Generator) -> tuple[CovariateResult, ...]:
    observations, lines = nominal.s, wheel_tests(nominal, noise, gap, rng)
    n = len(observations)
    weights = rng.multinomial(n, np.full(n, 1.0 / n), BOOTSTRAP_DRAWS).astype(np.float64)
    scaled = np.where(observations.usable, gap / noise.floor, np.nan)
    for name, values in covariate_values(observations).items():
        if (line := covariate_test(name, values, scaled, weights, max(noise.dof, 3.0))) is not None:
            lines.append(line)
    return holm_corrected(lines)


def _by_channel(observations: Observations, floor: FloatArray, gap: FloatArray) -> tuple[ChannelGap, ...]:
    return tuple(
        ChannelGap(
            channel=channel,
            rms=float(np.sqrt(np.mean(gap[on, channel] ** 2))),
            floor=float(np.sqrt(np.mean(floor[on, channel] ** 2))),
            mean=float(np.mean(gap[on, channel])),
            n_units=int(on.sum()),
        )
        for channel, on in zip(Channel, observations.usable.T, strict=True)
        if on.any()
    )


def by_run(observations: Observations, floor: FloatArray, gap: FloatArray) -> tuple[RunDeviation, ...]:
    """Return how far runs are off, the furthest first."""
    z = np.divide(gap, floor, out=np.zeros_like(gap), where=observations.usable)
    worst = np.abs(z).argmax(axis=1)
    size = np.abs(z)[np.arange(len(observations)), worst]
    begin_s, end_s = observations.start_s.tolist(), observations.time_s[observations.starts[1:] - 1].tolist()
    timed = np.isfinite(np.add(begin_s, end_s)) & observations.windowed
    return tuple(
        RunDeviation(
            run_id=str(observations.labels["run_id"][unit]),
            channel=Channel(worst[unit]),
            value=float(gap[unit, worst[unit]]),
            floor=float(floor[unit, worst[unit]]),
            z=float(z[unit, worst[unit]]),
            from_s=begin_s[unit] if timed[unit] else None,
            to_s=end_s[unit] if timed[unit] else None,
        )
        for unit in np.argsort(-size, kind="stable")[:MAX_LISTED_RUNS].tolist()
    )


def holm_corrected(lines: list[CovariateResult]) -> tuple[CovariateResult, ...]:
    """Return the table, smallest p first, held by Holm's steps to its chance of any false line."""
    # rounding must not order covariates that vary alike
    ordered = sorted(lines, key=lambda line: (float(f"{line.p_value:.9g}"), -float(f"{line.share:.9g}")))
    stepped = [line.p_value * (len(ordered) - number) for number, line in enumerate(ordered)]
    stands = np.maximum.accumulate(stepped) <= FALSE_FINDING_PROBABILITY
    return tuple(replace(one, significant=bool(significant)) for one, significant in zip(ordered, stands, strict=True))


#: known values that a test needs
MIN_RUNS: Final = 6
#: of turns that differ by the wheels' noise, which the gap shares
MIN_TURN_RAD: Final = 0.3
MIN_LENGTH_VARIATION: Final = 0.05
#: correlation beyond which wheels cannot be asked beside each other
MAX_WHEEL_CORRELATION: Final = 0.9999


def covariate_values(observations: Observations) -> dict[str, FloatArray | StrArray]:
    """Return what varies and the gap may depend on, by name, (n_units,): numbers, or labels."""
    number, labels = observations.number, observations.labels
    load_left, load_right = observations.wheel_loads_N
    by_wheels = observations.total(observations.turn_rad)
    turn = np.where(observations.usable[:, Channel.HEADING], observations.measured[:, Channel.HEADING], by_wheels)
    speed = number("speed_mps")
    values: dict[str, FloatArray | StrArray] = {"route": labels["kind"]}
    values |= {name: labels[name] for name in ("session", "direction")}
    values |= {name: number(name) for name in ("payload_kg", "load_left_N", "load_right_N")}
    values |= {"load_sum_N": load_left + load_right, "load_difference_N": load_right - load_left}
    values["speed_mps"] = speed if np.isfinite(speed).any() else driven_speed_mps(observations)
    values |= {name: number(name) for name in ("temperature_C", "minutes_under_load", "travelled_km")}
    if np.ptp(turn) > MIN_TURN_RAD:
        turned = observations.total(np.abs(observations.turn_rad)) - np.abs(by_wheels - turn)
        values |= {"turn": turn, "turn_absolute": np.maximum(turned, 0.0)}
    if np.ptp(observations.length_m) > MIN_LENGTH_VARIATION * float(np.max(observations.length_m)):
        values["length_m"] = observations.length_m
    values |= {name: number(name) for name in ("amplitude_m", "wavelength_m", *covariate_columns(observations))}
    return {name: column for name, column in values.items() if _varied(column)}


def _varied(values: FloatArray | StrArray) -> bool:
    if values.dtype.kind == "f":
        known = values[np.isfinite(values)]
        return len(known) >= MIN_RUNS and float(np.ptp(known)) > 1e-9 * max(float(np.abs(known).max()), 1e-9)
    return len(np.unique(values[values != ""])) > 1


def covariate_test(
    name: str, values: FloatArray | StrArray, scaled: FloatArray, weights: FloatArray, most_dof: float
) -> CovariateResult | None:
    """Test a covariate in every channel by an F test of the gap over its noise level; None if none allows it.

    Of the smallest p, times the number of channels. `scaled` (n_units, n_channels): gap over noise level, NaN where a
    unit lacks the channel; `weights` (n_draws, n_units): how often the bootstrap draws each; `most_dof`: of the noise
    level; see `covariate_values`.
    """
    dependences = [(channel, each) for channel in Channel if (each := _Dependence.of(values, scaled[:, channel]))]
    if not dependences:
        return None
    p_values = [dependence.p_value(most_dof) for _, dependence in dependences]
    channel, dependence = dependences[int(np.argmin(p_values))]
    return CovariateResult(
        name=name,
        channel=channel,
        share=float(dependence.shares(np.ones((1, len(dependence.y))))[0]),
        ci95=interval(dependence.shares(weights[:, dependence.on])),
        p_value=float(min(1.0, min(p_values) * len(dependences))),
        significant=False,
        n_units=int(dependence.on.sum()),
    )


def interval(shares: FloatArray) -> tuple[float, float] | None:
    """Return the middle 95 % of bootstrapped shares (n_draws,); None if most are unknown."""
    known = shares[np.isfinite(shares)]
    if len(known) < 0.5 * len(shares):
        return None
    return float(np.quantile(known, 0.025)), float(np.quantile(known, 0.975))


@dataclass(frozen=True, slots=True, eq=False)
class _Dependence:
    on: BoolArray
    y: FloatArray
    x: FloatArray | None
    group: IntArray | None

    @staticmethod
    def of(values: FloatArray | StrArray, y: FloatArray) -> "_Dependence | None":
        if values.dtype.kind == "f":
            on = np.isfinite(y) & np.isfinite(values)
            x = floats(values[on])
            if on.sum() < MIN_RUNS or np.ptp(x) <= 1e-9 * max(float(np.abs(x).max()), 1e-9):
                return None
            return _Dependence(on, y[on], (x - x.mean()) / np.std(x), None)
        on = np.isfinite(y) & (values != "")
        names, group = np.unique(values[on], return_inverse=True)
        if len(names) < 2 or on.sum() < max(MIN_RUNS, 2 * len(names)):
            return None
        return _Dependence(on, y[on], None, np.asarray(group, dtype=np.int64))

    @property
    def df(self) -> int:
        return 1 if self.group is None else int(self.group.max())

    def squares(self, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
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
        # the residual is no smaller or better known than the noise level
        from scipy.special import fdtrc

        total, explained, n = (float(part[0]) for part in self.squares(np.ones((1, len(self.y)))))
        dof = n - self.df - 1.0
        residual = max((total - explained) / dof, 1.0)
        return float(fdtrc(self.df, min(dof, most_dof), max(explained, 0.0) / self.df / residual))

    def shares(self, weight: FloatArray) -> FloatArray:
        total, explained, n = self.squares(weight)
        return _share(explained, self.df, total - explained, n - self.df - 1.0, total - (n - 1.0))


def _share(explained: FloatArray, df: int, left: FloatArray, dof: FloatArray, beyond: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.maximum(left / np.maximum(dof, 1.0), 1.0)
        return np.clip(np.where(beyond > 0, (explained - df * residual) / beyond, 0.0), 0.0, 1.0)


def wheel_tests(nominal: Path, noise: Noise, gap: FloatArray, rng: np.random.Generator) -> list[CovariateResult]:
    """Return what each wheel's travel explains of the gap (n_units, n_channels), if they are told apart."""
    from scipy.special import fdtrc

    products, sizes = _products(nominal, noise, gap)
    whole = products.sum(axis=0)
    norm = np.sqrt(np.diag(whole)[:2])
    if sizes.sum() < MIN_RUNS or not (norm > 0).all() or abs(whole[0, 1]) > MAX_WHEEL_CORRELATION * norm[0] * norm[1]:
        return []
    n_units, n = len(sizes), float(sizes.sum())
    draws = rng.multinomial(n_units, np.full(n_units, 1.0 / n_units), BOOTSTRAP_DRAWS).astype(np.float64)
    lines = []
    for wheel, name in enumerate(("left wheel", "right wheel")):
        explained, unexplained = _partial_squares(whole[None], wheel)
        residual = max(float(unexplained[0]) / max(n - 2.0, 1.0), 1.0)
        # without an intercept the noise level is as well known as by repeats
        p = float(fdtrc(1.0, float(np.clip(noise.dof, 3.0, max(n - 2.0, 3.0))), float(explained[0]) / residual))
        share = float(_shares(whole[None], np.array([n]), wheel)[0])
        ci95 = interval(_shares(np.tensordot(draws, products, axes=1), draws @ sizes, wheel))
        lines.append(CovariateResult(name, None, share, ci95, p, significant=False, n_units=n_units))
    return lines


def _products(nominal: Path, noise: Noise, gap: FloatArray) -> tuple[FloatArray, FloatArray]:
    usable = nominal.s.usable
    white = whitened_rows(nominal, noise, np.concatenate([nominal.calibration[:, :, :2], gap[:, :, None]], axis=2))
    unit = np.repeat(np.arange(len(usable))[:, None], N_CHANNELS, axis=1)[usable]
    products = np.zeros((len(usable), 3, 3))
    np.add.at(products, unit, white[:, :, None] * white[:, None, :])
    return products, usable.sum(axis=1).astype(np.float64)


def _shares(moments: FloatArray, count: FloatArray, wheel: int) -> FloatArray:
    explained, unexplained = _partial_squares(moments, wheel)
    return _share(explained, 1, unexplained, count - 2.0, moments[:, 2, 2] - count)


def _partial_squares(moments: FloatArray, wheel: int) -> tuple[FloatArray, FloatArray]:
    other = 1 - wheel
    with np.errstate(all="ignore"):
        ratio = moments[:, wheel, other] / moments[:, other, other]
        own = moments[:, wheel, wheel] - ratio * moments[:, other, wheel]
        right = moments[:, wheel, 2] - ratio * moments[:, other, 2]
        by_other = moments[:, other, 2] ** 2 / moments[:, other, other]
        explained = np.nan_to_num(right**2 / own)
    return explained, np.maximum(moments[:, 2, 2] - by_other - explained, 0.0)
