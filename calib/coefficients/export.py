"""From a campaign, a result or a coefficient file to its coefficients, and to files in an export format."""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from calib.campaign.wheels import SOURCE_NAMES
from calib.coefficients import formats
from calib.coefficients.file import FORMAT, CoefficientFile, Outside, load_coefficients
from calib.coefficients.formats import Artifact, ExportOptions, LoadPair
from calib.errors import BadFileError, BadInputError, RefusedError, refuse_other_than_date
from calib.io import refuse_existing, write_bytes, write_files

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.radius.result import Fit


@dataclass(frozen=True, slots=True)
class Source:
    """Coefficients, with notes on their origin for the user."""

    file: CoefficientFile
    notes: tuple[str, ...] = ()


def coefficients_of(
    path: Path | str, *, outside: str | None = None, created: str | None = None, accept: str = ""
) -> Source:
    """Return the coefficients of a campaign (fitted now), a result folder or its ``fit.json``, or a coefficient file.

    A campaign whose odometry has no rear wheels, a front wheel or four of them alone, has those of its geometry.

    `outside`, `created`: see `calib.coefficients.build.Header`; None: as the coefficient file says, else refuse and no
    date; `accept`: why a law beyond the bounds of its vehicle is passed on all the same; empty: it is refused. Raises
    BadInputError where the path, `outside` or `created` cannot be used; RefusedError where the campaign allows no law.
    """
    from calib.radius.result import is_result, read_result

    path = Path(path)
    if outside not in (None, *get_args(Outside)):
        raise BadInputError(f"outside: found {outside!r}; expected refuse or clamp; choose one of them")
    if created is not None:
        refuse_other_than_date(created)
    changes = {key: value for key, value in (("outside", outside), ("created", created)) if value is not None}
    if not path.exists():
        expected = "a campaign folder, a result folder of calib fit, or a coefficient file"
        raise BadFileError(path, "nothing", expected, "give the path of one")
    if path.is_file() and (path.suffix != ".json" or _is_coefficients(path)):
        file = load_coefficients(path)
        return Source(file.changed(**changes) if changes else file)
    if is_result(path):
        return coefficients_from(read_result(path), accept, **changes)
    from calib.campaign.read import read_campaign

    return coefficients_from(read_campaign(path), accept, **changes)


def coefficients_from(given: Fit | Campaign, accept: str = "", **changes: Any) -> Source:
    """Return the coefficients of a fit or of a campaign, which is fitted now; see `coefficients_of`."""
    from calib.campaign.wheels import without_rear_wheels
    from calib.coefficients.build import from_fit, from_geometry
    from calib.radius.fit import fit_campaign
    from calib.radius.result import Fit

    if isinstance(given, Fit):
        fit, inputs = given, None
    elif without_rear_wheels(given):
        from calib.kinematics.estimate import estimate_geometry

        geometry = estimate_geometry(given)
        how = "no rear wheel was counted: radii and lengths are those of 'calib geometry'"
        return Source(from_geometry(geometry, given, accept=accept, **changes), (*geometry.notes, how))
    else:
        fit, inputs = fit_campaign(given), given.hashes
    master = from_fit(replace(fit, accepted=accept), inputs=inputs, **changes)
    failed = [(name, check) for name, wheel in fit.wheels.items() for check in wheel.checks if not check.passed]
    notes = tuple(f"{name} wheel, check {check.name} failed: {check.sentence}" for name, check in failed)
    return Source(master, notes)


def effects_left_out(file: CoefficientFile, what: str) -> tuple[str, ...]:
    """Return one sentence that names the model's effects that `what` leaves out; nothing where there are none."""
    if not file.effects:
        return ()
    names = ", ".join(dict.fromkeys(effect.effect for effect in file.effects))
    return (f"{what}: {names} of the model; its radius laws and its track alone are used",)


def _is_coefficients(path: Path) -> bool:
    try:
        document = json.loads(path.read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and document.get("format") == FORMAT


def export(
    file: CoefficientFile, to: str, loads: Sequence[LoadPair] = (), *, options: ExportOptions | None = None
) -> tuple[Artifact, ...]:
    """Return the files of a coefficient file in another format, of `calib.coefficients.formats.FORMATS`.

    `loads`: for formats that hold for single loads; none: those of `options`, else the format's own choice. Raises
    BadInputError where there is no such format, or an option is another format's; RefusedError where the format cannot
    say what the file says.
    """
    chosen = options or ExportOptions()
    if to not in formats.FORMATS:
        raise BadInputError(f"to: found {to!r}; expected one of {', '.join(formats.FORMATS)}; choose one of them")
    if to != "ros2" and chosen.has_controller_choices:
        raise BadInputError(
            f"controllers, position feedback and open loop: found a choice of them for {to!r}; expected 'ros2', which "
            "alone has them; leave them out"
        )
    if to == "json":
        return (Artifact("coefficients.json", file.to_bytes()),)
    if chosen.has_model and to not in formats.PATCHING:
        raise BadInputError(
            f"--into, --left, --right: found them with {to!r}; expected mjcf, urdf or sdf; leave them out"
        )
    together = file.joint_geometry
    if to in formats.AXLE_ONLY and together is not None and together.source != "rear":
        wheels = SOURCE_NAMES[together.source]
        raise RefusedError(
            f"--to {to}: found odometry from {wheels}; expected two wheels on one axle, which alone this format has; "
            "export to ros2 or json"
        )
    chosen = replace(chosen, loads=tuple(loads) or chosen.loads)
    module, _, function = formats.FORMATS[to].partition(".")
    render = getattr(importlib.import_module(f"{formats.__name__}.{module}"), function)
    artifacts: tuple[Artifact, ...] = render(file, chosen)
    return artifacts


def parse_loads(texts: Iterable[str]) -> tuple[LoadPair, ...]:
    """Return load points from texts in N: ``600`` for both wheels, ``500,700`` for left and right."""
    pairs = []
    for text in texts:
        parts = text.split(",")
        try:
            values = [float(part) for part in parts]
        except ValueError:
            values = []
        # the comparison also refuses NaN
        if len(values) not in (1, 2) or not all(0.0 <= value < float("inf") for value in values):
            raise BadInputError(f"load: found {text!r}; expected N, or LEFT,RIGHT in N; for example 600 or 500,700")
        pairs.append(LoadPair(values[0], values[-1]))
    return tuple(pairs)


def place(artifacts: Sequence[Artifact], output: Path, *, force: bool) -> list[dict[str, str]]:
    """Write the files of an export to a file, where there is one and `output` is no folder, else into that folder.

    Returns ``path`` and ``sha256`` of each. Raises BadInputError where a file exists and `force` is False; nothing is
    then written.
    """
    single = len(artifacts) == 1 and not output.is_dir() and output.suffix != ""
    targets = [output if single else output / artifact.name for artifact in artifacts]
    refuse_existing(targets, force=force)
    if single:
        write_bytes(output, artifacts[0].data, force=force)
    else:
        write_files(output, {artifact.name: artifact.data for artifact in artifacts}, force=force)
    return [
        {"path": str(target), "sha256": hashlib.sha256(artifact.data).hexdigest()}
        for target, artifact in zip(targets, artifacts, strict=True)
    ]
