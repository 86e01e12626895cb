"""Where the gap lies: results by channel, covariate, run, and place inside the runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from calib.documents import plain_fields
from calib.gap.observations.arrays import Channel

#: name of all channels together
ALL_CHANNELS = "all"


#: fields of a place that is a stretch
STRETCH_FIELDS: Final = ("route", "coordinate", "place", "place_ci95", "by_direction", "floor")


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """The gap in one channel."""

    channel: Channel = field(metadata={"json": False})
    #: root mean squares of gap and noise level, in the channel's unit
    rms: float
    floor: float
    mean: float = 0.0  #: mean of the gap
    n_units: int = 0  #: units with the channel

    @property
    def ratio(self) -> float | None:
        """Gap over noise level; None without a noise level."""
        return self.rms / self.floor if self.floor else None

    def to_dict(self) -> dict[str, Any]:
        """Return the gap as plain JSON values."""
        return plain_fields(self, unit=self.channel.unit)


@dataclass(frozen=True, slots=True)
class CovariateResult:
    """What the gap correlates with."""

    name: str  #: with its unit suffix; ``left wheel`` and ``right wheel`` for travel
    channel: Channel | None  #: where it shows most; None: all together
    share: float  #: of the variance above the noise level, 0 to 1
    ci95: tuple[float, float] | None  #: bootstrap interval of the share
    p_value: float  #: of no dependence, times the number of channels looked at
    significant: bool  #: at a chance of 5 % of any false line in the table
    n_units: int = 0  #: looked at

    @property
    def channel_label(self) -> str:
        """Name of the channel, ``all`` for all together."""
        return ALL_CHANNELS if self.channel is None else self.channel.label

    def to_dict(self) -> dict[str, Any]:
        """Return the line as plain JSON values."""
        return plain_fields(self, channel=self.channel_label)


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
class PlaceResult:
    """A place inside the runs where the gap opens."""

    where: str  #: ``zone`` or ``joint`` for a stretch of a route; ``turns`` or ``stops``
    channel: Channel  #: what opens there
    size: float  #: by how much, in `unit`
    ci95: tuple[float, float]  #: interval of the size
    unit: str  #: ``m``, ``rad``, or either per radian of turn
    p_value: float  #: times the number of places looked at
    n_runs: int  #: looked at
    what: str = ""  #: of turns and stops, what the size counts: ``per stop``
    #: of a stretch: kind of runs, and what counts its place
    route: str = ""
    coordinate: str = ""
    place: tuple[float, float] | None = None  #: its ends in m
    place_ci95: tuple[tuple[float, float], tuple[float, float]] | None = None
    by_direction: bool = False  #: whether its sign changes on the way back
    #: x and y of its ends on the ground, m
    floor: tuple[tuple[float, float], tuple[float, float]] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the line as plain JSON values, without fields that do not apply."""
        absent = STRETCH_FIELDS if self.place is None else ("what",)
        document = plain_fields(self, channel=self.channel.label)
        return {key: value for key, value in document.items() if key not in absent}


@dataclass(frozen=True, slots=True)
class GapLocation:
    """Where a gap lies."""

    channels: tuple[ChannelGap, ...] = ()  #: measured ones
    covariates: tuple[CovariateResult, ...] = ()  #: smallest p first
    runs: tuple[RunDeviation, ...] = ()  #: deviating most
    places: tuple[PlaceResult, ...] = ()  #: inside the runs, smallest p first
    notes: tuple[str, ...] = ()  #: what these runs cannot be asked
    rest: GapLocation | None = None  #: of what the named causes leave

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
