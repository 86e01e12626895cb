"""Where the gap lies: by channel, by covariate, by run, and inside the runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.gap.data.channels import Channel
from calib.gap.data.observations import Observations
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path
from calib.gap.where.along_run import find_places
from calib.gap.where.covariates import covariate_values
from calib.gap.where.dependence import dependence_on
from calib.gap.where.result import ChannelGap, CovariateLine, PlaceLine, RunLine, Where
from calib.gap.where.wheels import dependence_on_wheels

#: chance of any false finding over the whole table
FALSE_FINDING: Final = 0.05
BOOTSTRAPS: Final = 300
MOST_RUNS: Final = 8


def locate(
    observations: Observations,
    nominal: Path,
    noise: Noise,
    gap: FloatArray,
    *,
    rng: np.random.Generator,
    floor: FloatArray | None = None,
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
    floor : array of float, shape (n_units, n_channels), optional
        What the gap is shown against; that of `noise` where not given.
    campaign : Campaign, optional
        The same runs with their logs: without it, no places inside runs.
    """
    lines = dependence_on_wheels(nominal, noise, gap, rng)
    weights = rng.multinomial(
        len(observations), np.full(len(observations), 1.0 / len(observations)), BOOTSTRAPS
    ).astype(np.float64)
    scaled = np.where(observations.usable, gap / noise.floor, np.nan)
    for name, values in covariate_values(observations).items():
        line = dependence_on(name, values, scaled, weights, max(noise.dof, 3.0))
        if line is not None:
            lines.append(line)
    places: tuple[PlaceLine, ...] = ()
    notes: tuple[str, ...] = ("no logs were given: nothing can be said of places inside the runs",)
    if campaign is not None:
        places, notes = find_places(campaign, observations, rng)
    shown = noise.floor if floor is None else floor
    return Where(
        channels=_by_channel(observations, shown, gap),
        covariates=held_to_one_error(lines),
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


def _by_run(observations: Observations, floor: FloatArray, gap: FloatArray) -> tuple[RunLine, ...]:
    """Return the units that deviate most, each in the channel where it does."""
    z = np.divide(gap, floor, out=np.zeros_like(gap), where=observations.usable)
    worst = np.abs(z).argmax(axis=1)
    size = np.abs(z)[np.arange(len(observations)), worst]
    return tuple(
        RunLine(
            run_id=str(observations.labels["run_id"][unit]),
            channel=Channel(int(worst[unit])),
            value=float(gap[unit, worst[unit]]),
            floor=float(floor[unit, worst[unit]]),
            z=float(z[unit, worst[unit]]),
        )
        for unit in np.argsort(-size, kind="stable")[:MOST_RUNS]
    )


def held_to_one_error(lines: list[CovariateLine]) -> tuple[CovariateLine, ...]:
    """Return the table, smallest p first, each line held to the table's chance of any false one by Holm's steps.

    By hand: statsmodels has the same steps, but its import takes longer than all that is done here.
    """
    ordered = sorted(lines, key=lambda line: (line.p_value, -line.share))
    stepped = [line.p_value * (len(ordered) - number) for number, line in enumerate(ordered)]
    stands = np.maximum.accumulate(stepped) <= FALSE_FINDING
    return tuple(
        replace(line, significant=bool(significant)) for line, significant in zip(ordered, stands, strict=True)
    )
