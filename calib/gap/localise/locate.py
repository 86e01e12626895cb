"""Where the gap lies: by channel, covariate, run, and place inside the runs."""

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.documents import plain_fields
from calib.gap.inference.noise import Noise
from calib.gap.localise.along_run import MIN_TRACED_RUNS, TRACED_CHANNELS, PlaceResult, Trace, scan_route, traces_of
from calib.gap.localise.covariates import (
    BOOTSTRAP_DRAWS,
    CovariateResult,
    covariate_test,
    covariate_values,
    wheel_tests,
)
from calib.gap.observations.arrays import Channel, Observations
from calib.gap.observations.from_campaign import edges_along
from calib.gap.predict import Path
from calib.types import FloatArray, IntArray


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


#: chance of any false finding in the table
FALSE_FINDING_PROBABILITY: Final = 0.05
MAX_LISTED_RUNS: Final = 8
WINDOW_LENGTH_M: Final = 1.0
MIN_WINDOWS: Final = 10
MIN_STOPS: Final = 5
MIN_TURN_RAD_PER_M: Final = 0.1
#: runs below which errors are not clustered
MIN_CLUSTERS: Final = 8


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

    Every covariate is tested in every channel, see `covariate_test`; Holm's steps hold the table to one chance in
    twenty of any false finding. Shares have bootstrap intervals over units.

    `gap`, `left` (n_units, n_channels): measured minus simulated, 0 where a unit lacks the channel; the same with its
    causes fitted; `floor`: what the gap is shown against; `campaign`: the same runs with their logs.
    """
    observations, lines = nominal.s, _tested(nominal, noise, gap, rng)
    places, notes = _find_places(campaign, observations, rng)
    channels, runs = _by_channel(observations, floor, gap), by_run(observations, floor, gap)
    rest = GapLocation(covariates=_tested(nominal, noise, left, rng))
    return GapLocation(channels=channels, covariates=lines, runs=runs, places=places, notes=notes, rest=rest)


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
    # importing statsmodels takes longer
    # rounding must not order covariates that vary alike
    ordered = sorted(lines, key=lambda line: (float(f"{line.p_value:.9g}"), -float(f"{line.share:.9g}")))
    stepped = [line.p_value * (len(ordered) - number) for number, line in enumerate(ordered)]
    stands = np.maximum.accumulate(stepped) <= FALSE_FINDING_PROBABILITY
    return tuple(replace(one, significant=bool(significant)) for one, significant in zip(ordered, stands, strict=True))


def _find_places(
    campaign: Campaign, observations: Observations, rng: np.random.Generator
) -> tuple[tuple[PlaceResult, ...], tuple[str, ...]]:
    # beside each run's offset and slope: on a stretch over which the gap grows in all runs of a route, in turns or
    # straights, at stops; p values are multiplied by the number of places
    if np.isfinite(observations.simulated).any():
        return (), ("the simulated ends have no path: where inside a run the gap opens cannot be determined",)
    traces = traces_of(campaign.included(), observations)
    if not traces:
        note = "no log has a continuous reference or range_m: where inside a run the gap opens cannot be determined"
        return (), (note,)
    notes: list[str] = []
    candidates = compare_windows(traces)
    n_tests = len(candidates)
    for kind in dict.fromkeys(trace.kind for trace in traces):
        group = [trace for trace in traces if trace.kind == kind]
        if len(group) < MIN_TRACED_RUNS:
            few = f"fewer than {MIN_TRACED_RUNS} runs with a trace; no place along it is sought"
            notes.append(f"{kind or 'a route'}: {few}")
            continue
        both_ways = len({trace.back for trace in group}) == 2
        for channel in TRACED_CHANNELS:
            for signed in (False, True) if both_ways and channel is Channel.HEADING else (False,):
                if stretch := scan_route(kind, group, channel, rng, signed=signed):
                    candidates.append(stretch[0])
                    n_tests += stretch[1]
    corrected = (replace(place, p_value=min(1.0, place.p_value * max(n_tests, 1))) for place in candidates)
    found = [place for place in corrected if place.p_value <= FALSE_FINDING_PROBABILITY]
    return tuple(sorted(found, key=lambda place: place.p_value)), tuple(notes)


def compare_windows(traces: list[Trace]) -> list[PlaceResult]:
    """Return how much of the gap correlates with turns and stops, beside the way."""
    gained, run = _cut(traces)
    way, turn, stops = (gained[name] for name in ("way_m", "turn_rad", "stops"))
    lines = []
    for channel, name in TRACED_CHANNELS.items():
        on = np.isfinite(gained[name]) & (way > 1e-6)
        turning = on & (np.abs(turn) > MIN_TURN_RAD_PER_M * way)
        questions = []
        if turning.sum() >= MIN_WINDOWS and (on & ~turning).sum() >= MIN_WINDOWS:
            questions.append(("turns", turn, "per rad of signed turn"))
            questions.append(("turns", np.abs(turn), "per rad of total absolute rotation"))
        if (stops[on] > 0).sum() >= MIN_STOPS and (stops[on] == 0).sum() >= MIN_STOPS:
            questions.append(("stops", stops, "per stop"))
        for where, values, what in questions:
            lines.append(_line(np.stack([way, values, gained[name]], axis=1)[on], run[on], channel, where, what))
    return lines


def _cut(traces: list[Trace]) -> tuple[dict[str, FloatArray], IntArray]:
    edges = [edges_along(trace.way_m, float(trace.way_m[-1]) / WINDOW_LENGTH_M) for trace in traces]
    gained = {
        name: np.concatenate([np.diff(getattr(trace, name)[at]) for trace, at in zip(traces, edges, strict=True)])
        for name in (*TRACED_CHANNELS.values(), "way_m", "turn_rad", "stops")
    }
    run = np.repeat([trace.run_id for trace in traces], [len(at) - 1 for at in edges])
    return gained, np.unique(run, return_inverse=True)[1]


def _line(windows: FloatArray, run: IntArray, channel: Channel, where: str, what: str) -> PlaceResult:
    from scipy.special import stdtr

    size, error, dof = _slope(windows[:, :2], windows[:, 2], run)
    return PlaceResult(
        where=where,
        channel=channel,
        what=what,
        size=size,
        ci95=(size - 2 * error, size + 2 * error),
        unit=f"{channel.unit}/rad" if where == "turns" else channel.unit,
        p_value=float(2.0 * stdtr(dof, -abs(size) / max(error, 1e-15))),
        n_runs=len(np.unique(run)),
    )


def _slope(design: FloatArray, gap: FloatArray, run: IntArray) -> tuple[float, float, float]:
    gram = np.linalg.inv(design.T @ design + 1e-12 * np.eye(2))
    beta = gram @ (design.T @ gap)
    left = gap - design @ beta
    runs, cluster = np.unique(run, return_inverse=True)
    if len(runs) >= MIN_CLUSTERS:
        summed = np.zeros((len(runs), 2))
        np.add.at(summed, cluster, design * left[:, None])
        dof = float(len(runs) - 2)
        middle = summed.T @ summed * (len(runs) / dof)
    else:
        dof = float(len(gap) - 2)
        middle = design.T @ design * float(left @ left) / dof
    return float(beta[1]), float(np.sqrt((gram @ middle @ gram)[1, 1])), dof
