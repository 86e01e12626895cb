"""What a verdict says beside its causes: how far the gap shrinks, what is left, what could be seen, what to drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from calib.gap.data.channels import Channel
from calib.gap.evidence.noise import Noise

#: on which runs corrections are compared
DRIVEN: Final = "runs driven"
JOURNEYS: Final = "journeys"


def json_number(value: float) -> float | None:
    """Return a float that JSON can say, None where it is not finite."""
    return float(value) if np.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Group:
    """Effects that these runs cannot tell apart, the named one first."""

    effects: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Detectable:
    """The smallest size of an effect that these runs could show.

    Parameters
    ----------
    effect : str
        Id of the effect.
    smallest : str
        That size with its unit, in words; where `never`, why no size would show.
    never : bool
        Whether no size would show.
    """

    effect: str
    smallest: str
    never: bool = False

    @property
    def sentence(self) -> str:
        """The size, or ``never`` and why."""
        return f"never: {self.smallest}" if self.never else self.smallest


@dataclass(frozen=True, slots=True)
class ChannelClosure:
    """How far the gap shrinks in one channel, on runs that the fit has not seen.

    Parameters
    ----------
    channel : Channel
        Which channel.
    before_rms, after_rms, floor_rms : float
        Root mean square of the gap without and with the causes, and of the floor, in the channel's unit.
    fraction : float or None
        Of the squares beyond the floor that is closed, every unit weighed by its floor; None where the channel's gap is
        below half its floor: it did not move.
    """

    channel: Channel
    before_rms: float
    after_rms: float
    floor_rms: float
    fraction: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "before_rms": self.before_rms,
            "after_rms": self.after_rms,
            "floor_rms": self.floor_rms,
            "unit": self.channel.unit,
            "fraction": self.fraction,
        }


@dataclass(frozen=True, slots=True)
class Closure:
    """How far the gap shrinks on runs that the fit has not seen.

    Parameters
    ----------
    before_rms_m, after_rms_m, floor_rms_m : float or None
        Root mean square of the gap at the ends (of the distance where no end was measured) by the model alone, by the
        model with the causes, and of the floor.
    fraction : float or None
        Of the gap beyond the floor that is closed, every run and channel weighed by its noise; None where the gap is
        below half the floor.
    ci95 : tuple of float or None
        Its interval.
    held_out : str
        What was left out in turn: ``session`` or ``condition``.
    channels : tuple of ChannelClosure
        The same channel by channel, each in its own unit and against its own floor.
    """

    before_rms_m: float | None = None
    after_rms_m: float | None = None
    floor_rms_m: float | None = None
    fraction: float | None = None
    ci95: tuple[float, float] | None = None
    held_out: str = "condition"
    channels: tuple[ChannelClosure, ...] = ()

    @property
    def moved(self) -> tuple[ChannelClosure, ...]:
        """Channels whose gap stands above the floor, furthest first."""
        beyond = [line for line in self.channels if line.fraction is not None]
        return tuple(sorted(beyond, key=lambda line: -line.before_rms / line.floor_rms))

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "before_rms_m": self.before_rms_m,
            "after_rms_m": self.after_rms_m,
            "floor_rms_m": self.floor_rms_m,
            "fraction": self.fraction,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "held_out": self.held_out,
            "by_channel": {line.channel.label: line.fraction for line in self.channels},
            "channels": {line.channel.label: line.to_dict() for line in self.channels},
        }


@dataclass(frozen=True, slots=True)
class Rest:
    """What no named cause explains: its share of the gap, its signal, and where it lies, in words."""

    share: float
    signal: float
    where: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {"share": json_number(self.share), "signal": json_number(self.signal), "where": list(self.where)}


@dataclass(frozen=True, slots=True)
class Transfer:
    """What the fix does on runs of a kind, speed, load or direction that it was not fitted on.

    Parameters
    ----------
    left_out : str
        What was left out: ``kind``, ``speed``, ``load``, ``direction``, ``session``.
    value : str
        Which of them.
    before_rms_m, after_rms_m : float or None
        Root mean square of the gap there without and with the fix.
    """

    left_out: str
    value: str
    before_rms_m: float | None
    after_rms_m: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "left_out": self.left_out,
            "value": self.value,
            "before_rms_m": self.before_rms_m,
            "after_rms_m": self.after_rms_m,
        }


@dataclass(frozen=True, slots=True)
class Fix:
    """What the correction is worth.

    Parameters
    ----------
    recommended : bool
        Whether to apply it.
    agreement_m : float or None
        By how much the corrections of causes that cannot be told apart differ at the end; None where nothing is tied.
    agreement_on : str
        On which runs: ``runs driven`` or ``journeys``.
    nothing_else : float
        Probability that no further effect of the library is at work beside what is named.
    transfer : tuple of Transfer
        What it did where it was tried.
    """

    recommended: bool = False
    agreement_m: float | None = None
    agreement_on: str = DRIVEN
    nothing_else: float = 1.0
    transfer: tuple[Transfer, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "recommended": self.recommended,
            "agreement_m": self.agreement_m,
            "agreement_on": self.agreement_on,
            "nothing_else": self.nothing_else,
            "transfer": [trial.to_dict() for trial in self.transfer],
        }


@dataclass(frozen=True, slots=True)
class NoiseSummary:
    """The floor, and what it rests on.

    Parameters
    ----------
    dof : float
        Degrees of freedom that repeats give it.
    scales : mapping of str to float
        Its scales by name.
    supported : bool
        Whether the runs support a floor at all.
    support : str
        What supports it, in words; where nothing does, why.
    excess : mapping of Channel to float
        Floor over that of the stated sigmas and typical wheels.
    finding : str
        A sentence where the floor is far above the stated sigmas.
    """

    dof: float = 0.0
    scales: Mapping[str, float] = field(default_factory=dict)
    supported: bool = True
    support: str = ""
    excess: Mapping[Channel, float] = field(default_factory=dict)
    finding: str = ""

    @classmethod
    def about(cls, noise: Noise) -> NoiseSummary:
        """Return what is to be said of a floor."""
        excess = {channel: float(noise.excess[channel]) for channel in Channel if np.isfinite(noise.excess[channel])}
        return cls(noise.dof, noise.scales, noise.supported, noise.support, excess, noise.finding)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "dof": self.dof,
            "scales": dict(self.scales),
            "supported": self.supported,
            "support": self.support,
            "excess": {channel.label: value for channel, value in self.excess.items()},
        }


@dataclass(frozen=True, slots=True)
class PlannedRunAdvice:
    """A run to drive next, and why.

    Parameters
    ----------
    kind, direction : str
        Route, and ``out`` or ``back``; the second empty where that means nothing.
    payload_kg, payload_x_m, payload_y_m : float or None
        Payload and its place; None where the place means nothing.
    speed_mps, temperature_C, minutes_under_load : float or None
        Conditions; None where any will do.
    stops : int
        Stops on the way.
    read_rolling : bool
        Whether the reference is read while the vehicle rolls.
    columns : mapping of str to float
        Further columns of the run.
    why : str
        What it tells.
    distance : float or None
        By how many standard deviations the nearest tied effects then lie apart; None where there is no tie.
    """

    kind: str
    why: str
    direction: str = ""
    payload_kg: float | None = None
    payload_x_m: float | None = None
    payload_y_m: float | None = None
    speed_mps: float | None = None
    temperature_C: float | None = None
    minutes_under_load: float | None = None
    stops: int = 0
    read_rolling: bool = False
    columns: Mapping[str, float] = field(default_factory=dict)
    distance: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return what there is to say of it as plain JSON values."""
        document: dict[str, Any] = {"kind": self.kind}
        if self.direction:
            document["direction"] = self.direction
        for name in ("payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "temperature_C", "minutes_under_load"):
            value = getattr(self, name)
            if value is not None:
                document[name] = value
        if self.stops:
            document["stops"] = self.stops
        if self.read_rolling:
            document["read_rolling"] = True
        document |= {**self.columns, "why": self.why}
        return document if self.distance is None else document | {"distance": self.distance}
