"""From whatever the user names, campaign, result folder or coefficient file, to its coefficients."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from calib.coefficients.file import FORMAT, CoefficientFile, Outside, load_coefficients
from calib.errors import BadFileError, BadInputError

if TYPE_CHECKING:
    from calib.campaign.model import Campaign


@dataclass(frozen=True, slots=True)
class Source:
    """Coefficients, and what their user should know of where they come from, in sentences."""

    file: CoefficientFile
    notes: tuple[str, ...] = ()


def coefficients_of(
    path: Path | str, *, outside: str | None = None, created: str | None = None, accept: str = ""
) -> Source:
    """Return the coefficients of a campaign (fitted now), a result folder or its ``fit.json``, or a coefficient file.

    A campaign whose odometry has no rear wheels, a front wheel or four of them alone, has those of its geometry.

    `path`: the campaign's folder, the result folder or its ``fit.json``, or a coefficient file; `outside` ({"refuse",
    "clamp"}): what happens outside the valid load range; None: as the coefficient file says, else refuse; `created`:
    date as YYYY-MM-DD; None: as the coefficient file says, else none; `accept`: why a law beyond the bounds of its
    vehicle is passed on all the same; empty: it is refused. Raises BadInputError where the path, `outside` or `created`
    cannot be used; RefusedError where the campaign allows no law.
    """
    from calib.radius.result import is_result, read_result

    path = Path(path)
    wanted = _outside(outside)
    if created is not None:
        _check_date(created)
    if not path.exists():
        expected = "a campaign folder, a result folder of calib fit, or a coefficient file"
        raise BadFileError(path, "nothing", expected, "give the path of one")
    if path.is_file() and (path.suffix != ".json" or _is_coefficients(path)):
        file = load_coefficients(path)
        changes = {"outside": wanted, "created": created}
        kept = {key: value for key, value in changes.items() if value is not None}
        return Source(file.changed(**kept) if kept else file)
    from calib.coefficients.build import from_fit

    inputs = None
    if is_result(path):
        fit = read_result(path)
    else:
        from calib.campaign.read import read_campaign
        from calib.campaign.wheels import without_rear_wheels
        from calib.radius.fit import fit_campaign

        campaign = read_campaign(path)
        if without_rear_wheels(campaign):
            return _by_geometry(campaign, wanted or "refuse", created)
        fit, inputs = fit_campaign(campaign), campaign.hashes
    fit = replace(fit, accepted=accept)
    master = from_fit(fit, outside=wanted or "refuse", created=created, inputs=inputs)
    notes = tuple(
        f"{name} wheel, check {check.name} failed: {check.sentence}"
        for name, wheel in fit.wheels.items()
        for check in wheel.checks
        if not check.passed
    )
    return Source(master, notes)


def _by_geometry(campaign: Campaign, outside: Outside, created: str | None) -> Source:
    """Return the coefficients of a vehicle without rear encoders: there is no law of a load, but a geometry."""
    from calib.coefficients.from_geometry import from_geometry
    from calib.geometry.estimate import estimate_geometry

    geometry = estimate_geometry(campaign)
    file = from_geometry(geometry, campaign, outside=outside, created=created)
    return Source(file, (*geometry.notes, "no rear wheel was counted: radii and lengths are those of 'calib geometry'"))


def effects_left_out(file: CoefficientFile, what: str) -> tuple[str, ...]:
    """Return one sentence that names the model's effects that `what` leaves out; nothing where there are none.

    `file`: perhaps with effects beside its laws, as ``calib diagnose --apply`` writes them; `what`: what does not use
    them, for example ``not simulated``.
    """
    if not file.effects:
        return ()
    names = ", ".join(dict.fromkeys(effect.effect for effect in file.effects))
    return (f"{what}: {names} of the model; its radius laws and its track alone are used",)


def _outside(text: str | None) -> Outside | None:
    if text is None or text == "refuse":
        return "refuse" if text else None
    if text == "clamp":
        return "clamp"
    raise BadInputError(f"outside: found {text!r}; expected refuse or clamp; choose one of them")


def _check_date(text: str) -> None:
    try:
        fine = len(text) == len("YYYY-MM-DD") and bool(date.fromisoformat(text))
    except ValueError:
        fine = False
    if not fine:
        raise BadInputError(f"date: found {text!r}; expected a date as YYYY-MM-DD; for example 2025-03-31")


def _is_coefficients(path: Path) -> bool:
    try:
        document = json.loads(path.read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and document.get("format") == FORMAT
