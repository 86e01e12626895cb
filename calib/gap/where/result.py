"""Where the gap lies, as typed lines: channels, covariates, runs, and places inside the runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calib.gap.data.channels import Channel

#: what a line is called that stands for all channels together
ALL_CHANNELS = "all"


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """The gap in one channel."""

    channel: Channel  #: which
    #: rms, floor: root mean square of the gap, and of its floor, over the units that have the channel; in the channel's
    #: unit
    rms: float
    floor: float
    mean: float = 0.0  #: mean of the gap
    n_units: int = 0  #: how many units have the channel

    @property
    def ratio(self) -> float | None:
        """Gap over floor; None without a floor."""
        return self.rms / self.floor if self.floor else None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "rms": self.rms,
            "floor": self.floor,
            "mean": self.mean,
            "unit": self.channel.unit,
            "n_units": self.n_units,
        }


@dataclass(frozen=True, slots=True)
class CovariateLine:
    """What the gap goes with."""

    name: str  #: covariate, with its unit suffix; ``left wheel`` and ``right wheel`` for the wheels' travel
    channel: Channel | None  #: where it shows most; None where it was asked of all channels together
    share: float  #: of the variance beyond the floor, 0 to 1
    ci95: tuple[float, float] | None  #: bootstrap interval of the share
    p_value: float  #: of no dependence, times the number of channels looked at
    significant: bool  #: whether it stands with a chance of 5 % of any false line in the table
    n_units: int = 0  #: how many units were looked at

    @property
    def channel_label(self) -> str:
        """Name of the channel, ``all`` for all together."""
        return ALL_CHANNELS if self.channel is None else self.channel.label

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "name": self.name,
            "share": self.share,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "p_value": self.p_value,
            "significant": self.significant,
            "channel": self.channel_label,
            "n_units": self.n_units,
        }


@dataclass(frozen=True, slots=True)
class RunLine:
    """A run that deviates much: its channel, gap and floor in the channel's unit, and their ratio `z`."""

    run_id: str
    channel: Channel
    value: float
    floor: float
    z: float

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "run_id": self.run_id,
            "channel": self.channel.label,
            "value": self.value,
            "floor": self.floor,
            "z": self.z,
        }


@dataclass(frozen=True, slots=True)
class PlaceLine:
    """A place inside the runs where the gap opens."""

    where: str  #: ``zone`` or ``joint`` for a stretch of a route; ``turns`` or ``stops``
    channel: Channel  #: what opens there
    size: float  #: by how much, in `unit`
    ci95: tuple[float, float]  #: interval of the size
    unit: str  #: ``m``, ``rad``, or one of them per radian of turn
    p_value: float  #: times the number of places looked at
    n_runs: int  #: runs that were looked at
    what: str = ""  #: what the size counts, for turns and stops: ``per stop``
    #: route, coordinate: of a stretch: kind of the runs, and what its place is counted in
    route: str = ""
    coordinate: str = ""
    place: tuple[float, float] | None = None  #: of a stretch: its ends in m
    place_ci95: tuple[tuple[float, float], tuple[float, float]] | None = None  #: interval of either end in m
    by_direction: bool = False  #: of a stretch: whether the gap has the other sign on the way back
    #: of a stretch: x and y of its ends on the floor in m
    floor: tuple[tuple[float, float], tuple[float, float]] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        line: dict[str, Any] = {"where": self.where, "channel": self.channel.label}
        if self.place is None or self.place_ci95 is None or self.floor is None:
            line["what"] = self.what
        else:
            line |= {
                "route": self.route,
                "coordinate": self.coordinate,
                "place": list(self.place),
                "place_ci95": [list(ends) for ends in self.place_ci95],
                "by_direction": self.by_direction,
                "floor": [list(end) for end in self.floor],
            }
        return line | {
            "size": self.size,
            "ci95": list(self.ci95),
            "unit": self.unit,
            "p_value": self.p_value,
            "n_runs": self.n_runs,
        }


@dataclass(frozen=True, slots=True)
class Where:
    """Where a gap lies."""

    channels: tuple[ChannelGap, ...] = ()  #: those that were measured
    covariates: tuple[CovariateLine, ...] = ()  #: what it goes with, smallest p first
    runs: tuple[RunLine, ...] = ()  #: those that deviate most
    places: tuple[PlaceLine, ...] = ()  #: inside the runs, smallest p first
    notes: tuple[str, ...] = ()  #: what cannot be asked of these runs
    rest: Where | None = None  #: the same for what the named causes leave

    @property
    def significant(self) -> tuple[CovariateLine, ...]:
        """The covariates that stand."""
        return tuple(line for line in self.covariates if line.significant)

    def channel(self, channel: Channel) -> ChannelGap | None:
        """Return the gap in a channel, None where it was not measured."""
        return next((gap for gap in self.channels if gap.channel is channel), None)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values; ``rest`` only where there is one."""
        document: dict[str, Any] = {
            "channels": {gap.channel.label: gap.to_dict() for gap in self.channels},
            "covariates": [line.to_dict() for line in self.covariates],
            "runs": [line.to_dict() for line in self.runs],
            "places": [line.to_dict() for line in self.places],
            "notes": list(self.notes),
        }
        return document if self.rest is None else document | {"rest": self.rest.to_dict()}
