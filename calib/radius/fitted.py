"""The fit of a campaign: both wheels' laws with the runs, vehicle and conditions behind them, and what it says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.errors import BadInputError
from calib.radius.checks import PLAUSIBLE
from calib.radius.document import pair, plain_fields, radii_from_rows, rows_of, wheel_from_dict, wheel_to_dict
from calib.radius.effective import Component, EffectiveRadii
from calib.radius.law import RadiusLaw
from calib.radius.regression import WheelFit
from calib.radius.usable import LeftOut
from calib.seal import CHECKSUM_KEY, checksum
from calib.vehicle import Vehicle

if TYPE_CHECKING:
    from pandas import DataFrame

FORMAT: Final = "calib-fit/1"

_SECTIONS: Final[dict[str, type]] = {
    "vehicle": Vehicle,
    "encoder": Encoder,
    "model": OdometryModel,
    "rangefinder": Rangefinder,
    "reference": Reference,
}


@dataclass(frozen=True, slots=True)
class Setup:
    """What the runs were measured with and under, so that a report needs no campaign."""

    #: sections of ``campaign.toml``
    vehicle: Vehicle
    encoder: Encoder
    model: OdometryModel
    rangefinder: Rangefinder
    reference: Reference
    #: smallest and largest value over the runs used, by column of the run table
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: keys of ``campaign.toml`` that nobody stated and that matter for these runs, with the values that stand in
    assumed: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the setup as plain values, section by section."""
        sections = {name: asdict(getattr(self, name)) for name in _SECTIONS}
        conditions = {name: list(span) for name, span in self.conditions.items()}
        return {**sections, "conditions": conditions, "assumed": dict(self.assumed)}

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> Setup:
        """Return the setup that `to_dict` wrote."""
        sections: dict[str, Any] = {name: plain_fields(kind, value[name]) for name, kind in _SECTIONS.items()}
        return Setup(
            **sections,
            conditions={name: pair(span) for name, span in value["conditions"].items()},
            assumed={str(key): str(text) for key, text in value.get("assumed", {}).items()},
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fit:
    """Both wheels' laws and all that report and export need of the campaign behind them.

    Parameters
    ----------
    name : str
        Name of the campaign.
    simulated : bool
        True where a program made the data.
    left, right : WheelFit
        The moving wheels.
    radii : EffectiveRadii
        The runs behind them.
    static : mapping of str to WheelFit
        Static radius against load by wheel, where the run table has it.
    notes : tuple of str
        What the user should know, in sentences.
    provenance : mapping
        ``version`` of calib, ``inputs`` (path -> sha256), ``arguments``; filled by the command line.
    setup : Setup or None
        Vehicle, instruments and conditions; None where the radii came from elsewhere than a campaign.
    accepted : str
        Why the user passes on what the check ``plausible`` failed; empty where nobody does.
    """

    name: str
    simulated: bool
    left: WheelFit
    right: WheelFit
    radii: EffectiveRadii
    static: Mapping[str, WheelFit] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    setup: Setup | None = None
    accepted: str = ""

    @property
    def law(self) -> RadiusLaw:
        """The law of both wheels."""
        return RadiusLaw(left=self.left.law, right=self.right.law)

    @property
    def wheels(self) -> dict[str, WheelFit]:
        """The moving wheels by name."""
        return {"left": self.left, "right": self.right}

    @property
    def passed(self) -> bool:
        """Whether every check lets the law be used."""
        return all(check.passed for wheel in (self.left, self.right) for check in wheel.checks)

    @property
    def implausible(self) -> tuple[str, ...]:
        """What is beyond the bounds of a vehicle, in sentences; nothing of this kind is passed on unasked."""
        checks = [check for wheel in (self.left, self.right) for check in wheel.checks]
        return tuple(dict.fromkeys(check.sentence for check in checks if check.name == PLAUSIBLE and not check.passed))

    @property
    def table(self) -> DataFrame:
        """The runs used as a table: labels, loads, radii, their standard uncertainties and residuals; SI units."""
        from pandas import DataFrame

        return DataFrame(rows_of(self.radii, self.wheels))

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as plain values: the keys of ``calib fit --json`` and everything `from_dict` needs."""
        document = {
            "format": FORMAT,
            "campaign": self.name,
            "simulated": self.simulated,
            "wheels": {name: wheel_to_dict(wheel) for name, wheel in self.wheels.items()},
            "runs": rows_of(self.radii, self.wheels),
            "static": {name: wheel_to_dict(wheel) for name, wheel in self.static.items()},
            "budget": [asdict(component) for component in self.radii.budget],
            "left_out": [asdict(run) for run in self.radii.left_out],
            "notes": list(self.notes),
            "setup": None if self.setup is None else self.setup.to_dict(),
            "provenance": dict(self.provenance),
            "passed": self.passed,
        }
        return document | {CHECKSUM_KEY: checksum(document)}

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> Fit:
        """Return the fit that `to_dict` wrote.

        Raises BadInputError where a key is missing or of the wrong kind.
        """
        if value.get("format") != FORMAT:
            raise BadInputError(
                f"found format {value.get('format')!r}; expected {FORMAT!r}; make it anew with 'calib fit'"
            )
        try:
            fit = Fit(
                name=str(value["campaign"]),
                simulated=bool(value["simulated"]),
                left=wheel_from_dict("left", value["wheels"]["left"]),
                right=wheel_from_dict("right", value["wheels"]["right"]),
                radii=radii_from_rows(
                    value["runs"],
                    budget=tuple(plain_fields(Component, component) for component in value["budget"]),
                    left_out=tuple(plain_fields(LeftOut, run) for run in value["left_out"]),
                    notes=tuple(value["notes"]),
                ),
                static={name: wheel_from_dict(name, wheel) for name, wheel in value["static"].items()},
                notes=tuple(value["notes"]),
                provenance=dict(value["provenance"]),
                setup=None if value.get("setup") is None else Setup.from_dict(value["setup"]),
            )
            _same_runs(fit)
            return fit
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise BadInputError(
                f"the fit is damaged ({type(error).__name__}: {error}); expected what 'calib fit' wrote; make it anew"
            ) from error


def _same_runs(fit: Fit) -> None:
    """Refuse a fit that lists another number of runs than its wheels were fitted on."""
    listed = len(fit.radii.run_id)
    for name, wheel in fit.wheels.items():
        columns = (wheel.load_N, wheel.radius_m, wheel.residual_m, wheel.leverage, wheel.cook)
        if any(len(column) != listed for column in columns):
            raise ValueError(f"{listed} runs are listed, and the {name} wheel was fitted on {len(wheel.load_N)}")
