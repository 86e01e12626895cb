"""Export in a format of `calib.coefficients.formats`, and writing the files."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.coefficients import formats
from calib.coefficients.file import CoefficientFile
from calib.coefficients.loads import Artifact, ExportOptions, LoadPair
from calib.errors import BadInputError, RefusedError
from calib.files import refuse_existing, write_bytes
from calib.folders import write_files


def export(
    file: CoefficientFile, to: str, loads: Sequence[LoadPair] = (), *, options: ExportOptions | None = None
) -> tuple[Artifact, ...]:
    """Return the files of a coefficient file in another format.

    `to`: a name of `calib.coefficients.formats.FORMATS`; `loads`: load points, for formats that hold for single loads;
    none: those of `options`, else the format's own choice. Raises BadInputError where there is no such format, or a
    controller's choice is given for another format than ``ros2``; RefusedError where the format cannot say what the
    file says.
    """
    chosen = options or ExportOptions()
    if to not in formats.FORMATS:
        raise BadInputError(f"to: found {to!r}; expected one of {', '.join(formats.FORMATS)}; choose one of them")
    if to != "ros2" and chosen.has_controller_choices:
        raise BadInputError(
            f"controllers, position feedback and open loop: found a choice of them for {to!r}; expected 'ros2', which "
            "alone has them; leave them out"
        )
    module = importlib.import_module(f"{formats.__name__}.{formats.FORMATS[to]}")
    together = file.joint_geometry
    if getattr(module, "AXLE_ONLY", False) and together is not None and together.source != "rear":
        wheels = "the front wheel" if together.source == "front" else "four wheels"
        raise RefusedError(
            f"--to {to}: found odometry from {wheels}; expected two wheels on one axle, which alone this format has; "
            "export to ros2 or json"
        )
    chosen = replace(chosen, loads=tuple(loads) or chosen.loads)
    artifacts: tuple[Artifact, ...] = module.render(file, chosen)
    return artifacts


def parse_loads(texts: Iterable[str]) -> tuple[LoadPair, ...]:
    """Return load points from texts: ``600`` for both wheels, ``500,700`` for left and right, in N.

    Raises BadInputError where a text is neither.
    """
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


def place(artifacts: Sequence[Artifact], output: Path, *, force: bool) -> list[dict[str, Any]]:
    """Write the files of an export.

    `output`: a file where there is one artifact and `output` is no folder; else the folder that gets them. ``path`` and
    ``sha256`` of each. Raises BadInputError where a file exists and `force` is False; nothing is written then.
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
