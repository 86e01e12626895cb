"""MuJoCo's MJCF: radii of the wheels' geoms, and the bodies' places."""

from __future__ import annotations

from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions
from calib.coefficients.formats.model_file import (
    ModelFile,
    Node,
    Slot,
    Wheel,
    named,
    numbers,
    patched,
    written,
)
from calib.coefficients.formats.urdf import off_zero
from calib.errors import RefusedError

#: see `calib.coefficients.formats`
AXLE_ONLY: Final = True
PATCHES_MODEL: Final = True
#: geoms whose first size is their radius
ROUND: Final = frozenset({"sphere", "capsule", "cylinder"})
#: attributes that turn a frame
TURNS: Final = ("quat", "axisangle", "xyaxes", "zaxis", "euler")


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return a copy of the model with the radii, the track and the axles' heights of the coefficient file.

    Raises BadInputError where the model or a wheel's name cannot be used; RefusedError where a wheel has no radius.
    """
    return patched(file, options, "mujoco", _wheel)


def _wheel(model: ModelFile, name: str, option: str) -> Wheel:
    body = _body(model, name, option)
    rounds = [(geom, _shape(model, geom)) for geom in body.children if geom.tag == "geom"]
    sizes = [(geom, shape) for geom, shape in rounds if shape is not None]
    if not sizes:
        included = any(node.tag == "include" for node in model.root.walk())
        hint = "give the included file that holds it" if included else "give a wheel of a sphere, capsule or cylinder"
        raise RefusedError(f"{model.path}: found no round geom in the body of {name!r}; expected one; {hint}")
    radius = max(shape[0] for _, shape in sizes)

    def slot(geom: Node, shape: tuple[float, ...]) -> Slot:
        return Slot(shape, lambda values: model.set_attribute(geom, "size", written(values)))

    slots = tuple(slot(geom, shape) for geom, shape in sizes if shape[0] == radius)
    turned = next(
        (node.attributes.get("name", node.tag) for node in body.ancestors() if set(TURNS) & set(node.attributes)), None
    )
    if turned is not None:
        return Wheel(name, body, radius, slots, None, why_fixed=f"since the frame of {turned!r} is turned")
    place = numbers(body.attributes.get("pos", "0 0 0"), f"{model.path}, pos of {name!r}", 3)
    position = Slot(place, lambda values: model.set_attribute(body, "pos", written(values)))
    off = any(off_zero(_inherited(model, geom, "pos") or "") for geom, shape in sizes if shape[0] == radius)
    return Wheel(name, body, radius, slots, position, frame=body.parent, beside=off)


def _body(model: ModelFile, name: str, option: str) -> Node:
    """Return the body that a joint, a geom or the body itself of that name belongs to."""
    candidates: dict[str, list[Node]] = {}
    world = model.root.child("worldbody")
    for node in () if world is None else world.walk():
        body = node if node.tag == "body" else node.parent
        known = node.attributes.get("name")
        if known is None or body is None or body.tag != "body" or node.tag not in ("body", "joint", "geom"):
            continue
        bodies = candidates.setdefault(known, [])
        if body not in bodies:
            bodies.append(body)
    return named(candidates, name, model.path, option)


def _shape(model: ModelFile, geom: Node) -> tuple[float, ...] | None:
    """Return the size of a round geom, its own or that of its default class; None of another geom."""
    if _inherited(model, geom, "type") not in ROUND:
        return None
    size = _inherited(model, geom, "size")
    return None if size is None else numbers(size, f"{model.path}, size of geom {geom.attributes.get('name', '')!r}")


def _inherited(model: ModelFile, geom: Node, attribute: str) -> str | None:
    """Return an attribute as MuJoCo reads it: the geom's own, its class's, the nearest childclass's, the defaults'."""
    if attribute in geom.attributes:
        return geom.attributes[attribute]
    children = (node.attributes["childclass"] for node in geom.ancestors() if "childclass" in node.attributes)
    name = geom.attributes.get("class") or next(children, None)
    level = next((node for node in model.root.walk() if node.tag == "default" and _is_class(node, name)), None)
    while level is not None and level.tag == "default":
        stated = level.child("geom")
        if stated is not None and attribute in stated.attributes:
            return stated.attributes[attribute]
        level = level.parent
    return "sphere" if attribute == "type" else None


def _is_class(node: Node, name: str | None) -> bool:
    """Return whether a default element is that class; without a name, whether it is the outermost one."""
    if name is None or name == "main":
        return node.parent is not None and node.parent.tag != "default"
    return node.attributes.get("class") == name
