"""Where the gap lies: by channel, covariate, run, and place inside the runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.inference.noise import Noise
from calib.gap.localise.along_run import MIN_TRACED_RUNS, TRACED_CHANNELS, Trace, scan_route, traces_of
from calib.gap.localise.covariates import BOOTSTRAP_DRAWS, covariate_test, covariate_values, wheel_tests
from calib.gap.localise.result import ChannelGap, CovariateResult, GapLocation, PlaceResult, RunDeviation
from calib.gap.observations.arrays import Channel, Observations
from calib.gap.observations.from_campaign import edges_along
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, IntArray

#: chance of any false finding over the whole table
FALSE_FINDING_PROBABILITY: Final = 0.05
MAX_LISTED_RUNS: Final = 8
WINDOW_LENGTH_M: Final = 1.0
MIN_WINDOWS: Final = 10
MIN_STOPS: Final = 5
MIN_TURN_RAD_PER_M: Final = 0.1
#: with fewer runs, errors are not clustered by run
MIN_CLUSTERS: Final = 8


def locate(
    observations: Observations,
    nominal: Path,
    noise: Noise,
    gap: FloatArray,
    *,
    rng: np.random.Generator,
    floor: FloatArray | None = None,
    campaign: Campaign | None = None,
) -> GapLocation:
    """Say where the gap lies.

    Every covariate is tested in every channel by an F test of the gap over its noise level; the smallest p of a
    covariate is multiplied by the channels looked at, and the table is held to one chance in twenty of any false
    finding by Holm's steps. Shares come with bootstrap intervals over units.

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
    floor : array of float, shape (n_units, n_channels), optional
        What the gap is shown against; that of `noise` where not given.
    campaign : Campaign, optional
        The same runs with their logs: without it, no places inside runs.
    """
    lines = wheel_tests(nominal, noise, gap, rng)
    weights = rng.multinomial(
        len(observations), np.full(len(observations), 1.0 / len(observations)), BOOTSTRAP_DRAWS
    ).astype(np.float64)
    scaled = np.where(observations.usable, gap / noise.floor, np.nan)
    for name, values in covariate_values(observations).items():
        line = covariate_test(name, values, scaled, weights, max(noise.dof, 3.0))
        if line is not None:
            lines.append(line)
    places: tuple[PlaceResult, ...] = ()
    notes: tuple[str, ...] = ("no logs were given: nothing can be said of places inside the runs",)
    if campaign is not None:
        places, notes = find_places(campaign, observations, rng)
    shown = noise.floor if floor is None else floor
    return GapLocation(
        channels=_by_channel(observations, shown, gap),
        covariates=holm_corrected(lines),
        runs=_by_run(observations, shown, gap),
        places=places,
        notes=notes,
    )


def _by_channel(observations: Observations, floor: FloatArray, gap: FloatArray) -> tuple[ChannelGap, ...]:
    gaps = []
    for channel in Channel:
        on = observations.usable[:, channel]
        if on.any():
            gaps.append(
                ChannelGap(
                    channel=channel,
                    rms=float(np.sqrt(np.mean(gap[on, channel] ** 2))),
                    floor=float(np.sqrt(np.mean(floor[on, channel] ** 2))),
                    mean=float(np.mean(gap[on, channel])),
                    n_units=int(on.sum()),
                )
            )
    return tuple(gaps)


def _by_run(observations: Observations, floor: FloatArray, gap: FloatArray) -> tuple[RunDeviation, ...]:
    """Return the units that deviate most, each in the channel where it does."""
    z = np.divide(gap, floor, out=np.zeros_like(gap), where=observations.usable)
    worst = np.abs(z).argmax(axis=1)
    size = np.abs(z)[np.arange(len(observations)), worst]
    return tuple(
        RunDeviation(
            run_id=str(observations.labels["run_id"][unit]),
            channel=Channel(int(worst[unit])),
            value=float(gap[unit, worst[unit]]),
            floor=float(floor[unit, worst[unit]]),
            z=float(z[unit, worst[unit]]),
            **_times(observations, int(unit)),
        )
        for unit in np.argsort(-size, kind="stable")[:MAX_LISTED_RUNS]
    )


def _times(observations: Observations, unit: int) -> dict[str, float]:
    """Return when a window of a recording begins and ends; nothing for whole runs."""
    steps = slice(int(observations.starts[unit]), int(observations.starts[unit + 1]))
    end, first = (
        float(observations.time_s[steps][-1]),
        observations.time_s[steps][0] - observations.duration_s[steps][0],
    )
    if not observations.windowed or not np.isfinite([first, end]).all():
        return {}
    return {"from_s": float(first), "to_s": end}


def holm_corrected(lines: list[CovariateResult]) -> tuple[CovariateResult, ...]:
    """Return the table, smallest p first, each line held to the table's chance of any false one by Holm's steps.

    Own code: statsmodels has the same steps, but its import takes longer than all that is done here.
    """
    ordered = sorted(lines, key=lambda line: (line.p_value, -line.share))
    stepped = [line.p_value * (len(ordered) - number) for number, line in enumerate(ordered)]
    stands = np.maximum.accumulate(stepped) <= FALSE_FINDING_PROBABILITY
    return tuple(
        replace(line, significant=bool(significant)) for line, significant in zip(ordered, stands, strict=True)
    )


def find_places(
    campaign: Campaign, observations: Observations, rng: np.random.Generator
) -> tuple[tuple[PlaceResult, ...], tuple[str, ...]]:
    """Say where inside the runs the gap opens, smallest p first, and what cannot be asked of these runs.

    A run's calibration, that is an offset and a slope of the gap along the way, is omitted first. The remainder is
    searched for a stretch over which it grows, on the same route by all of its runs (corridor runs out and back by
    their place on the ground), and compared between turns and straights, stops and none. All p values are multiplied by
    the number of places looked at; the chance of any false place is 5 %.
    """
    traces = traces_of(campaign.included(), observations)
    if not traces:
        return (), (
            "no log has a continuous reference or range_m: where inside a run the gap opens cannot be determined",
        )
    groups: dict[str, list[Trace]] = {}
    for trace in traces:
        groups.setdefault(trace.kind, []).append(trace)
    notes: list[str] = []
    n_tests = 0
    candidates: list[PlaceResult] = []
    for kind, group in groups.items():
        if len(group) < MIN_TRACED_RUNS:
            notes.append(
                f"{kind or 'a route'}: fewer than {MIN_TRACED_RUNS} runs with a trace; no place along it is sought"
            )
            continue
        both_ways = len({trace.back for trace in group}) == 2
        for channel in TRACED_CHANNELS:
            for signed in (False, True) if both_ways and channel is Channel.HEADING else (False,):
                stretch = scan_route(kind, group, channel, rng, signed=signed)
                if stretch is not None:
                    candidates.append(stretch[0])
                    n_tests += stretch[1]
    compared = compare_windows(traces)
    n_tests += len(compared)
    corrected = [
        replace(place, p_value=float(min(1.0, place.p_value * max(n_tests, 1)))) for place in (*candidates, *compared)
    ]
    places = sorted(
        (place for place in corrected if place.p_value <= FALSE_FINDING_PROBABILITY), key=lambda place: place.p_value
    )
    return tuple(places), tuple(notes)


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """What each window gained in gap, way, turn and stops, each shape (n_windows,); `run` is the number of its run."""

    along: FloatArray
    heading: FloatArray
    way: FloatArray
    turn: FloatArray
    stops: FloatArray
    run: IntArray

    @property
    def bend(self) -> FloatArray:
        """Total absolute rotation, shape (n_windows,)."""
        return np.abs(self.turn)

    def gap(self, channel: Channel) -> FloatArray:
        """Return what was gained in a channel, shape (n_windows,)."""
        return self.along if channel is Channel.ALONG else self.heading


def compare_windows(traces: list[Trace]) -> list[PlaceResult]:
    """Return how much of the gap correlates with turns and with stops, beside the way, each with its own p."""
    windows = _cut(traces)
    lines = []
    for channel in (Channel.ALONG, Channel.HEADING):
        on = np.isfinite(windows.gap(channel)) & (windows.way > 1e-6)
        turning = on & (windows.bend > MIN_TURN_RAD_PER_M * windows.way)
        straight = on & ~turning
        questions = []
        if turning.sum() >= MIN_WINDOWS and straight.sum() >= MIN_WINDOWS:
            questions.append(("turns", windows.turn, "per rad of signed turn"))
            questions.append(("turns", windows.bend, "per rad of total absolute rotation"))
        if (windows.stops[on] > 0).sum() >= MIN_STOPS and (windows.stops[on] == 0).sum() >= MIN_STOPS:
            questions.append(("stops", windows.stops, "per stop"))
        lines += [_line(windows, channel, on, values, where, what) for where, values, what in questions]
    return lines


def _cut(traces: list[Trace]) -> _Windows:
    """Cut the runs into windows of about a metre."""
    parts: dict[str, list[FloatArray]] = {name: [] for name in ("along", "heading", "way", "turn", "stops")}
    run: list[IntArray] = []
    numbers = {name: number for number, name in enumerate(sorted({trace.run_id for trace in traces}))}
    for trace in traces:
        edges = edges_along(trace.way_m, float(trace.way_m[-1]) / WINDOW_LENGTH_M)
        gained = (trace.along_m, trace.heading_rad, trace.way_m, trace.turn_rad, trace.stops)
        for values, windows in zip(gained, parts.values(), strict=True):
            windows.append(np.diff(values[edges]))
        run.append(np.full(len(edges) - 1, numbers[trace.run_id]))
    return _Windows(**{name: np.concatenate(windows) for name, windows in parts.items()}, run=np.concatenate(run))


def _line(windows: _Windows, channel: Channel, on: BoolArray, values: FloatArray, where: str, what: str) -> PlaceResult:
    """Return the regression of a channel's gap on the way and on `values`, all shape (n_windows,), as a line."""
    from scipy.special import stdtr

    design = np.stack([windows.way[on], values[on]], axis=1)
    size, error, dof = _slope(design, windows.gap(channel)[on], windows.run[on])
    return PlaceResult(
        where=where,
        channel=channel,
        what=what,
        size=size,
        ci95=(size - 2 * error, size + 2 * error),
        unit=f"{channel.unit}/rad" if where == "turns" else channel.unit,
        p_value=float(2.0 * stdtr(dof, -abs(size) / max(error, 1e-15))),
        n_runs=len(np.unique(windows.run[on])),
    )


def _slope(design: FloatArray, gap: FloatArray, run: IntArray) -> tuple[float, float, float]:
    """Return the second coefficient of a regression on way and what is asked (n, 2), its standard error and dof.

    Errors are clustered by run where there are enough runs. Own code: statsmodels divides the clustered squares by
    other degrees of freedom than the t that is read with them, and its import takes longer than the diagnosis' tables.
    """
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
