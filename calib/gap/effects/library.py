"""The library of effects: the list of classes, the effects of a campaign, and the signature of each."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from calib.documents import plain
from calib.errors import COVARIATES, BadInputError, refuse_beyond
from calib.gap.effects import encoder, floor, load, path, radii, reference, steering, turning
from calib.gap.effects.columns import Covariate, column_of, covariate_columns, declared_effects, entry_point_effects
from calib.gap.effects.effect import Effect, Family, Form
from calib.gap.effects.simulator import SIMULATOR_PREFIX, simulator_title
from calib.gap.observations.arrays import POSE, Channel, Observations
from calib.gap.predict import Path, predict, signature
from calib.gap.steps import Perturbation
from calib.types import FloatArray

#: the effects of the library, in the order of listings; a new one is a class and a line here
EFFECTS: Final[tuple[type[Effect], ...]] = (
    radii.RadiusScale,
    radii.UnequalRadii,
    radii.TrackWidth,
    load.LoadRadius,
    load.LoadRadiusNonlinear,
    load.LoadCreep,
    encoder.WheelEccentricity,
    turning.CurveLoadTransfer,
    turning.LoadDependentTrack,
    path.BrakingSkid,
    radii.SpeedRadius,
    radii.TemperatureRadius,
    radii.Wear,
    radii.SessionStep,
    encoder.LostCounts,
    encoder.EncoderBlunder,
    reference.RangefinderScale,
    reference.ReferenceScale,
    reference.RangefinderOffset,
    reference.BeamMisalignment,
    reference.GyroScale,
    reference.ReferenceLeverArm,
    reference.ReferenceYaw,
    reference.ReferenceLatency,
    floor.RearDrag,
    floor.TravelDirection,
    turning.WheelSlip,
    turning.SideSlip,
    turning.CurveScrub,
    steering.SteeringZero,
    radii.SteeringZeroStep,
    steering.SteeringScale,
    steering.SteeringBacklash,
    steering.SteeringDelay,
    turning.DriveSlip,
    turning.Understeer,
    load.PayloadMass,
    load.PayloadPosition,
    floor.FloorSlope,
    floor.FloorZone,
    floor.FloorUndulation,
    path.PathWeave,
    path.IntegrationScheme,
)
#: id -> class
REGISTRY: Final = {effect.id: effect for effect in EFFECTS}
#: origin of the registered effects
LIBRARY: Final = Effect.origin
#: a path on a floor plan is drawn apart by about this share of its extent
DRAWN_SHARE: Final = 0.12
#: largest factor by which an effect is enlarged for a floor plan
MAX_ENLARGEMENT: Final = 200.0


def effect_class(name: str) -> type[Effect] | None:
    """Return the class of a registered effect, None for any other id."""
    return REGISTRY.get(name)


def title_of(name: str) -> str:
    """Return the title of an effect by its id; the id in plain words where the effect is the user's own."""
    if name in REGISTRY:
        return REGISTRY[name].title
    if name.startswith(SIMULATOR_PREFIX):
        return simulator_title(name.removeprefix(SIMULATOR_PREFIX))
    column = column_of(name)
    return name.replace("_", " ") if column is None else Covariate(column).title


def why_not_transferable(name: str) -> str:
    """Return why the correction of an effect does not hold for future journeys, empty where it does."""
    return REGISTRY[name].not_transferable if name in REGISTRY else ""


def library(observations: Observations, *, exclude: Collection[str] = (), declared: object = ()) -> list[Effect]:
    """Return the candidate effects of a campaign: of the library, of its further columns, and the user's own.

    Effects found before the search are no candidates, nor is a column that an effect acts through. `declared`: the
    ``[[effects]]`` tables of ``campaign.toml``.
    """
    registered, covariates, own = _all(observations, declared)
    taken = {column for effect in own if effect.id not in exclude for column in effect.columns}
    # a counted drive shaft tells what the load does to the mean of both rear wheels
    told = Family.LOAD if observations.by_shaft else None
    hidden = [e for e in registered if observations.by_front and e.of_rear_wheels and e.family != told]
    searched = [e for e in registered if not (e.found_before_search or e in hidden)]
    candidates = [*searched, *(effect for effect in covariates if effect.column not in taken), *own]
    return [effect for effect in candidates if effect.id not in exclude]


def every_effect(observations: Observations, *, declared: object = ()) -> dict[str, Effect]:
    """Return all effects that a file of effects, or an exclusion, may name on a campaign, by id."""
    registered, covariates, own = _all(observations, declared)
    return {effect.id: effect for effect in (*registered, *covariates, *own)}


def check_excluded(exclude: Collection[str], observations: Observations, declared: object = ()) -> None:
    """Refuse to exclude an unknown effect; the error names ids that begin alike."""
    known = every_effect(observations, declared=declared)
    for name in exclude:
        if name not in known:
            near = ", ".join(other for other in known if other[:4] == name[:4]) or ", ".join(known)
            raise BadInputError(f"exclude: found {name!r}; expected an effect of the library; choose of: {near}")


def _all(observations: Observations, declared: object) -> tuple[list[Effect], list[Covariate], list[Effect]]:
    registered = [kind() for kind in EFFECTS]
    taken_columns = {column for effect in registered for column in effect.columns}
    covariates = [Covariate(name) for name in covariate_columns(observations) if name not in taken_columns]
    taken = [effect.id for effect in (*registered, *covariates)]
    own = declared_effects(declared, observations, taken)
    own += entry_point_effects([*taken, *(effect.id for effect in own)])
    refuse_beyond(
        len(covariates) + len(own),
        COVARIATES,
        shown="the campaign",
        what="further numeric columns and effects of its own, each a cause to be looked for",
        remedy="keep the columns that could matter",
    )
    return registered, covariates, own


@dataclass(frozen=True, slots=True, eq=False)
class EffectSignature:
    """What an effect does to the readings of given runs, to first order."""

    effect: Effect
    form: Form  #: of its forms the one with the largest signature
    #: shape (n_obs, n_channels): change of each reading at typical sizes, NaN where an observation lacks the channel
    change: FloatArray
    enlarged: Path  #: the paths with the effect enlarged until it is visible on a floor plan
    factor: float  #: enlargement over the typical size

    def rms_by_kind(self) -> dict[str, FloatArray]:
        """Return the root mean square change of each channel, shape (n_channels,), by kind of run."""
        kinds = self.enlarged.s.labels["kind"]

        def rms(square: FloatArray) -> FloatArray:
            known = np.isfinite(square).sum(axis=0)
            return np.sqrt(np.where(known > 0, np.nansum(square, axis=0) / np.maximum(known, 1), np.nan))

        return {str(kind): rms(self.change[kinds == kind] ** 2) for kind in np.unique(kinds)}


def signature_of(effect: Effect, nominal: Path) -> EffectSignature | None:
    """Return the signature of an effect on the runs of a path; None where it has no form there."""
    observations = nominal.s
    offered: list[tuple[float, Form, list[Perturbation], FloatArray]] = []
    for form in effect.forms(observations):
        pairs = zip(form.perturbations(nominal), form.typical, strict=True)
        typical = [perturbation.scaled(size) for perturbation, size in pairs]
        change = np.sum([signature(nominal, perturbation) for perturbation in typical], axis=0)
        change = np.where(observations.usable, change, np.nan)
        offered.append((float(np.sqrt(np.nansum(change**2))), form, typical, change))
    if not offered:
        return None
    _, form, typical, change = max(offered, key=lambda each: each[0])
    away = float(np.nanmax(np.abs(change[:, POSE]), initial=0.0))
    extent = float(nominal.of_parts(lambda part: np.hypot(part.steps.x_m, part.steps.y_m)).max(initial=1.0))
    factor = float(np.clip(DRAWN_SHARE * extent / away, 1.0, MAX_ENLARGEMENT)) if away > 0 else 1.0
    enlarged = predict(observations, [perturbation.scaled(factor) for perturbation in typical])
    return EffectSignature(effect, form, change, enlarged, factor)


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """An effect of the catalogue."""

    effect: Effect
    #: its signature on the runs at its typical size; None where they do not excite it
    signature: EffectSignature | None
    #: shape (n_channels,): root mean square change of each channel by kind of run, NaN where a kind lacks the channel
    changes: Mapping[str, FloatArray]

    @property
    def origin(self) -> str:
        """Where it comes from."""
        return self.effect.origin

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain JSON values; sizes in SI units."""
        form = None if self.signature is None else self.signature.form
        texts = ("id", "title", "family", "needs", "separates", "implausible", "origin")
        return {name: str(getattr(self.effect, name)) for name in texts} | {
            "shows": form is not None,
            "form": "" if form is None else form.label,
            "parameters": [] if form is None else plain(form.parameters),
            "signature": {
                kind: {channel.label: float(rms[channel]) for channel in Channel if np.isfinite(rms[channel])}
                for kind, rms in self.changes.items()
            },
        }


def catalogue(nominal: Path, declared: object = (), only: Collection[str] = ()) -> list[Entry]:
    """Return the effects that runs can be judged by, those of the ids `only` or all.

    In order: the library, columns of the run table, declared effects, installed packages.
    """
    every = every_effect(nominal.s, declared=declared)
    for name in only:
        if name not in every:
            raise BadInputError(f"found the effect {name!r}; expected one of: {', '.join(every)}")
    entries = []
    for name, effect in every.items():
        if not only or name in only:
            shown = signature_of(effect, nominal)
            changes = {} if shown is None else shown.rms_by_kind()
            entries.append(Entry(effect, shown, changes))
    return entries
