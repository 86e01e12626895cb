"""The library of effects: all classes, the effects of a campaign with their signatures, and those of a file."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.read import SETTINGS
from calib.campaign.settings import OdometryModel
from calib.documents import plain
from calib.errors import COVARIATES, BadInputError, refuse_beyond
from calib.gap import Perturbation
from calib.gap.effects import (
    Centre,
    Effect,
    Family,
    Form,
    encoder,
    floor,
    load,
    matching_form,
    radii,
    reference,
    simulator,
    steering,
    turning,
)
from calib.gap.effects.encoder import Blunder, EncoderBlunder, corrected
from calib.gap.effects.mounting import RESTATED
from calib.gap.effects.quantities import (
    COVARIATE_PREFIX,
    Covariate,
    covariate_columns,
    declared_effects,
    entry_point_effects,
)
from calib.gap.effects.radii import Wear
from calib.gap.effects.reference import ReferenceLatency, ReferenceLeverArm
from calib.gap.effects.simulator import SIMULATOR_PREFIX, simulator_title
from calib.gap.observations import POSE, Channel, Observations
from calib.gap.predict import Path, predict, signature
from calib.radius.law import within_law
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.coefficients.file import CoefficientFile
    from calib.coefficients.sections import EffectSection

#: in the order of listings; a new one is a class and a line here
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
    radii.BrakingSkid,
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
    radii.PathWeave,
    simulator.IntegrationScheme,
)
REGISTRY: Final = {effect.id: effect for effect in EFFECTS}
LIBRARY: Final = Effect.origin
#: smallest change of a channel (m or rad): no instrument resolves a micrometre
UNCHANGED: Final = 1e-6
#: of a floor plan's extent, by which a path is drawn apart
DRAWN_SHARE: Final = 0.12
#: largest factor by which an effect is enlarged for a floor plan
MAX_ENLARGEMENT: Final = 200.0


def effect_class(name: str) -> type[Effect]:
    """Return the class of a registered effect; `Effect` for any other id."""
    return REGISTRY.get(name, Effect)


def title_of(name: str) -> str:
    """Return the title of an effect by its id; of the user's own the id in plain words."""
    if name in REGISTRY:
        return REGISTRY[name].title
    if name.startswith(SIMULATOR_PREFIX):
        return simulator_title(name.removeprefix(SIMULATOR_PREFIX))
    if name.startswith(COVARIATE_PREFIX):
        return Covariate(name.removeprefix(COVARIATE_PREFIX)).title
    return name.replace("_", " ")


def library(observations: Observations, *, exclude: Collection[str] = (), declared: object = ()) -> list[Effect]:
    """Return the candidate effects of a campaign: of the library, of further columns, the user's own.

    Effects found before the search are no candidates, nor is a column that an effect acts through. `declared`: the
    ``[[effects]]`` tables of ``campaign.toml``.
    """
    registered, covariates, own = _all(observations, declared)
    taken = {column for effect in own if effect.id not in exclude for column in effect.columns}
    # a counted drive shaft tells what the load does to both wheels' mean
    family = Family.LOAD if observations.by_shaft else None
    hidden = [e for e in registered if observations.by_front and e.of_rear_wheels and e.family != family]
    searched = [e for e in registered if not (e.found_before_search or e in hidden)]
    candidates = [*searched, *(effect for effect in covariates if effect.column not in taken), *own]
    return [effect for effect in candidates if effect.id not in exclude]


def every_effect(observations: Observations, *, declared: object = ()) -> dict[str, Effect]:
    """Return all effects that a file of effects, or an exclusion, may name on a campaign, by id."""
    registered, covariates, own = _all(observations, declared)
    return {effect.id: effect for effect in (*registered, *covariates, *own)}


def check_excluded(exclude: Collection[str], observations: Observations, declared: object) -> None:
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
    own = declared_effects(declared, observations.numbers, taken)
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
        """Return each channel's rms change (n_channels,), by kind of run."""
        kinds = self.enlarged.s.labels["kind"]

        def rms(square: FloatArray) -> FloatArray:
            known = np.isfinite(square).sum(axis=0)
            return np.sqrt(np.where(known > 0, np.nansum(square, axis=0) / np.maximum(known, 1), np.nan))

        return {str(kind): rms(self.change[kinds == kind] ** 2) for kind in np.unique(kinds)}


def signature_of(effect: Effect, nominal: Path) -> EffectSignature | None:
    """Return an effect's signature on the runs of a path; None where it has no form there."""
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

    @property
    def changes(self) -> Mapping[str, FloatArray]:
        """Root mean square change of each channel by kind of run, (n_channels,), NaN where a kind lacks the channel."""
        return {} if self.signature is None else self.signature.rms_by_kind()

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
    """Return the effects that runs can be judged by, of the ids `only` or all, as in `library`."""
    every = every_effect(nominal.s, declared=declared)
    for name in only:
        if name not in every:
            raise BadInputError(f"found the effect {name!r}; expected one of: {', '.join(every)}")
    wanted = (effect for name, effect in every.items() if not only or name in only)
    return [Entry(effect, signature_of(effect, nominal)) for effect in wanted]


#: settings of where a covariate's effect is zero
CENTRE: Final = "centre"
SPREAD: Final = "spread"
#: ends the form of what counts through another campaign
ELSEWHERE: Final = " of other runs"
#: parameter of a geometry: by how much the reference reads late
DELAY: Final = "delay_s"


def model_of(path: FilePath | str, campaign: Campaign) -> "tuple[OdometryModel, tuple[EffectSection, ...]]":
    """Return what a coefficient file believes: the odometry's model, and the effects to add to it.

    The law is centred on the reference load of the campaign's model. Wear counts in the campaign that was diagnosed.
    """
    from calib.coefficients.file import believed_model, load_coefficients

    file = load_coefficients(path)
    file.refuse_other_vehicle(campaign)
    known = {one.sha256 for one in file.inputs}
    same = all(digest in known for name, digest in campaign.hashes.items() if name != SETTINGS)
    effects = [
        one if same or one.effect != Wear.id else one.model_copy(update={"form": one.form + ELSEWHERE})
        for one in file.effects
    ]
    return believed_model(file, campaign.model.reference_load_N), (*effects, *_delay_of(file))


def with_mounting_of(
    path: FilePath | str, campaign: Campaign, effects: "Sequence[EffectSection]" = ()
) -> "tuple[Campaign, tuple[EffectSection, ...]]":
    """Return the campaign with the reference's sensor where a coefficient file has it, and the other `effects`.

    A lever arm is a place, too; of positions alone place and delay tell the heading, which no effect on a course does.
    """
    from calib.coefficients.file import load_coefficients

    campaign = replace(campaign, reference=load_coefficients(path).sensor(campaign.reference))
    headed = np.isfinite(campaign.logs.columns.get("ref_theta_rad", np.full(1, np.nan))).any()
    others: list[EffectSection] = []
    for section in effects:
        kind = RESTATED.get((section.effect, section.form))
        if kind is None or (headed and section.effect != ReferenceLeverArm.id):
            others.append(section)
            continue
        names = sorted(section.parameters)
        sizes = np.array([section.parameters[name].value for name in names])
        campaign = kind(section.form, tuple(names), sizes, 0.0 * sizes).correct(campaign)
    return campaign, tuple(others)


def beyond_law(path: FilePath | str, observations: Observations) -> tuple[str, ...]:
    """Return one sentence where loads lie outside the valid range of a coefficient file."""
    from calib.coefficients.file import load_coefficients

    file = load_coefficients(path)
    text = "wheel loads lie outside the valid range of the model: its law is extended to them"
    return (f"{text} (on a vehicle: {file.outside})",) * (not within_law(file.law, *observations.loads_N).all())


def _delay_of(file: "CoefficientFile") -> "tuple[EffectSection, ...]":
    from calib.coefficients.sections import EffectSection, Quantity

    together = file.joint_geometry
    if together is None or not together.values.get(DELAY) or all(entry.first != DELAY for entry in together.covariance):
        return ()
    latency = {"latency": Quantity(value=together.values[DELAY], unit="s")}
    return (EffectSection(effect=ReferenceLatency.id, form=ReferenceLatency.OF_POSE, parameters=latency),)


def with_effects(
    observations: Observations, sections: "Sequence[EffectSection]", declared: object = ()
) -> tuple[Observations, tuple[str, ...]]:
    """Return the campaign as a simulator with the effects would predict it, and notes on what could not be applied.

    The prediction stands where an outside simulator's would; `declared`: the campaign's ``[[effects]]`` tables.
    """
    notes: list[str] = []
    for section in sections:
        if section.effect == EncoderBlunder.id:
            factors = {name: quantity.value for name, quantity in section.parameters.items()}
            fault = Blunder.from_factors(section.form, factors)
            if fault is None:
                notes.append("the model's encoder fault lacks its factors and was omitted")
            else:
                observations = corrected(observations, fault)
    others = [section for section in sections if section.effect != EncoderBlunder.id]
    if not others:
        return observations, tuple(notes)
    perturbations, left_out = applied_perturbations(observations, others, declared=declared)
    path = predict(observations, perturbations)
    own = observations.usable & ~np.isfinite(observations.simulated)
    simulated = np.where(own, path.reading, observations.simulated)
    return replace(observations, simulated=simulated), (*notes, *left_out)


def applied_perturbations(
    observations: Observations, sections: "Sequence[EffectSection]", path: Path | None = None, declared: object = ()
) -> tuple[list[Perturbation], list[str]]:
    """Return what written-down effects do, times their sizes, and notes on what could not be applied.

    A covariate's deviation is from the mean in the file. They act about `path`, by default the path that they give.
    """
    everywhere = replace(observations, applied=True)
    effects = every_effect(everywhere, declared=declared)
    notes: list[str] = []
    chosen: list[tuple[EffectSection, Form]] = []
    for section in sections:
        effect = effects.get(section.effect)
        form = None if effect is None else matching_form(effect.forms(everywhere), section.form, section.settings)
        if form is None:
            which = f"{section.effect} ({section.form or 'its only form'})"
            notes.append(f"the model's effect {which} has nothing to act on in these runs and was omitted")
            continue
        stated = section.settings
        centre = Centre(stated[CENTRE], stated.get(SPREAD, 1.0) or 1.0) if CENTRE in stated else None
        chosen.append((section, form.with_settings(stated).centred_at(centre)))
    if path is not None:
        return _perturbations(chosen, path), notes
    # an effect depends a little on the path that it bends
    about = predict(observations)
    for _ in range(2):
        about = predict(observations, _perturbations(chosen, about))
    return _perturbations(chosen, about), notes


def _perturbations(chosen: "Sequence[tuple[EffectSection, Form]]", path: Path) -> list[Perturbation]:
    scaled = []
    for section, form in chosen:
        for parameter, perturbation in zip(form.parameters, form.perturbations(path), strict=True):
            size = section.parameters.get(parameter.name)
            if size is not None and size.value != 0.0:
                scaled.append(perturbation.scaled(size.value))
    return scaled


def section_of(form: Form, theta: FloatArray) -> "EffectSection":
    """Return a fitted form as a coefficient file holds it."""
    from calib.coefficients.sections import EffectSection, Quantity

    settings = {name: float(value) for name, value in form.settings.items()}
    if form.centre is not None:
        settings |= {CENTRE: form.centre.mean, SPREAD: form.centre.spread}
    parameters = {
        parameter.name: Quantity(value=float(value), unit=parameter.unit)
        for parameter, value in zip(form.parameters, theta, strict=True)
    }
    return EffectSection(effect=form.effect, form=form.label, settings=settings, parameters=parameters)
