"""What the formats of simulators' models share: from a coefficient file to the wheels, and what no model can say."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, LoadPair, accepted_lines, ascii_line
from calib.coefficients.formats.model_file import ModelFile, NewWheels, Node, Wheel, numbers, set_wheels, written
from calib.errors import BadInputError

#: digits of a checksum that find the file
CHECKSUM_DIGITS: Final = 23
#: parameters of drive plugins and of ros2_control, and what they are of radii and track
PLUGIN_KEYS: Final[dict[str, Callable[[NewWheels], float]]] = {
    "wheel_radius": lambda new: 0.5 * (new.left_m + new.right_m),
    "wheelRadius": lambda new: 0.5 * (new.left_m + new.right_m),
    "left_wheel_radius": lambda new: new.left_m,
    "right_wheel_radius": lambda new: new.right_m,
    "wheel_diameter": lambda new: new.left_m + new.right_m,
    "wheelDiameter": lambda new: new.left_m + new.right_m,
    "wheel_separation": lambda new: new.track_m,
    "wheelSeparation": lambda new: new.track_m,
}


def patched(
    file: CoefficientFile,
    options: ExportOptions,
    root_tag: str,
    wheel: Callable[[ModelFile, str, str], Wheel],
    plugins: Callable[[ModelFile], Iterator[tuple[str, Node]]] | None = None,
) -> tuple[Artifact, ...]:
    """Return the user's model with both wheels and the drive plugins set, and what it cannot express.

    Parameters
    ----------
    file : CoefficientFile
        Radii and track.
    options : ExportOptions
        The model, the names of its wheels, and the load.
    root_tag : str
        Of the model's outermost element.
    wheel : callable
        Finds a wheel by its name; the third argument is the option that gave the name.
    plugins : callable, optional
        Yields name and element of parameters that may be those of `PLUGIN_KEYS`.

    Raises
    ------
    BadInputError
        Where model, names or loads cannot be used.
    """
    if options.model is None or not options.left or not options.right:
        raise BadInputError(
            "a model's export: found no model, or no name of a wheel; expected --into MODEL --left NAME --right NAME; "
            "give the file and the joints of both rear wheels"
        )
    if options.left == options.right:
        raise BadInputError(f"--right: found {options.right!r}, as for --left; expected two wheels; name each")
    if len(options.loads) > 1:
        raise BadInputError("--load: found several loads; expected one, a model has one radius a wheel; give one")
    model = ModelFile(options.model, root_tag)
    pair = options.loads[0] if options.loads else _reference(file)
    radii = [float(radius) for radius in file.radius_m(pair.left_N, pair.right_N)]
    new = NewWheels(radii[0], radii[1], file.vehicle.track.value)
    notes = [*set_wheels(wheel(model, options.left, "--left"), wheel(model, options.right, "--right"), new)]
    for name, node in () if plugins is None else plugins(model):
        _set_parameter(model, name, node, new, notes)
    notes += _beyond(file, pair)
    comment = (
        f"calib: wheels at {pair.left_N:g} N left, {pair.right_N:g} N right; coefficient file "
        f"{file.checksum[:CHECKSUM_DIGITS]}; campaign {ascii_line(file.name)}"
        + ("; SIMULATED DATA" if file.simulated else "")
        + "".join(f"; {line}" for line in accepted_lines(file))
    )
    return (Artifact(options.model.name, model.render(comment), tuple(dict.fromkeys(notes))),)


def _reference(file: CoefficientFile) -> LoadPair:
    return LoadPair(file.wheels.left.reference_load.value, file.wheels.right.reference_load.value)


def _set_parameter(model: ModelFile, name: str, node: Node, new: NewWheels, notes: list[str]) -> None:
    """Set a parameter of a plugin where it is one of radius or track."""
    if name not in PLUGIN_KEYS:
        return
    numbers(node.text, f"{model.path}, {name}", 1)
    model.set_text(node, written((PLUGIN_KEYS[name](new),)))
    if new.left_m != new.right_m and "left" not in name and "right" not in name and "eparation" not in name:
        notes.append(
            f"{name} of a plugin: one radius for both wheels, their ratio {new.right_m / new.left_m:.6f} is lost"
        )


def _beyond(file: CoefficientFile, pair: LoadPair) -> Iterator[str]:
    """Yield what the coefficient file says and no model does."""
    for side, load in (("left", pair.left_N), ("right", pair.right_N)):
        slope = getattr(file.law, side).slope_m_per_N
        if slope != 0.0:
            law = f"the {side} radius follows the load by {1e6 * slope:.3g} um/N"
            yield f"not in the model: {law}; the model has that at {load:g} N"
    for effect in file.effects:
        yield f"not in the model: effect {effect.effect}; calib.runtime adds it to the motion of a simulator's loop"
    together = file.joint_geometry
    for name in () if together is None else together.values:
        if name.startswith(("sensor_", "delay", "steering_")):
            yield f"not in the model: {name} {together.values[name]:.6g}"  # type: ignore[union-attr]
