"""ROS's URDF: radii of the wheels' collisions and visuals, the joints' places, ros2_control and drive plugins."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions
from calib.coefficients.formats.model_file import (
    ModelFile,
    Node,
    Slot,
    Wheel,
    attribute_slot,
    named,
    numbers,
    patched,
    written,
)
from calib.errors import RefusedError

#: see `calib.coefficients.formats`
AXLE_ONLY: Final = True
PATCHES_MODEL: Final = True
#: elements of URDF and SDF that have a radius
ROUND: Final = frozenset({"cylinder", "sphere", "capsule"})


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return a copy of the model with the radii, the track and the axles' heights of the coefficient file.

    Raises BadInputError where the model or a wheel's name cannot be used; RefusedError where a wheel has no radius.
    """
    return patched(file, options, "robot", _wheel, plugin_parameters)


def plugin_parameters(model: ModelFile) -> Iterator[tuple[str, Node]]:
    """Yield name and element of the parameters of plugins and of ros2_control."""
    for node in model.root.walk():
        if node.children or not any(above.tag in ("plugin", "ros2_control") for above in node.ancestors()):
            continue
        yield (node.attributes.get("name", "") if node.tag == "param" else node.tag), node


def link_radii(
    model: ModelFile, link: Node | None, name: str, radius: Callable[[Node], Slot | None]
) -> tuple[float, tuple[Slot, ...]]:
    """Return the radius of a wheel's link, of its collision where that is round, and all shapes that have the same.

    `radius`: the number of a round shape; None where it states none. Raises RefusedError where the link has no radius.
    """
    found: dict[str, list[Slot]] = {"collision": [], "visual": []}
    for part in () if link is None else link.children:
        if part.tag in found:
            found[part.tag] += [slot for shape in part.walk() if shape.tag in ROUND and (slot := radius(shape))]
    contact = found["collision"] or found["visual"]
    if not contact:
        raise RefusedError(
            f"{model.path}: found no cylinder, sphere or capsule in the link of {name!r}; expected one with a radius; "
            "a mesh has none: add a collision cylinder"
        )
    largest = max(slot.values[0] for slot in contact)
    return largest, tuple(slot for slots in found.values() for slot in slots if slot.values[0] == largest)


def off_zero(place: str) -> bool:
    """Return whether a place, three numbers first, is another than zero."""
    return any(part.strip("-+0.") for part in place.split()[:3])


def sits_off(link: Node | None) -> bool:
    """Return whether the collision of a URDF's or SDF's link is placed off the link's frame."""
    for part in () if link is None else link.children:
        place = part.child("origin") or part.child("pose") if part.tag == "collision" else None
        if place is not None and off_zero(place.attributes.get("xyz", place.text)):
            return True
    return False


def _wheel(model: ModelFile, name: str, option: str) -> Wheel:
    joints = [node for node in model.root.children if node.tag == "joint"]
    candidates: dict[str, list[Node]] = {}
    for node in joints:
        for known in {node.attributes.get("name", ""), _link(node, "child")} - {""}:
            candidates.setdefault(known, []).append(node)
    joint = named(candidates, name, model.path, option)
    link = next((part for part in model.root.children if _is_link(part, _link(joint, "child"))), None)

    def stated(shape: Node) -> Slot | None:
        return attribute_slot(model, shape, "radius", f"radius of {name!r}") if "radius" in shape.attributes else None

    radius, slots = link_radii(model, link, name, stated)
    tilted = _tilted(model, joints, _link(joint, "parent"))
    assert link is not None
    if tilted:
        return Wheel(name, link, radius, slots, None, why_fixed=f"since joint {tilted!r} above it is tilted")
    origin = joint.child("origin")
    text = "0 0 0" if origin is None else origin.attributes.get("xyz", "0 0 0")
    place = numbers(text, f"{model.path}, origin of {name!r}", 3)

    def write(values: tuple[float, ...]) -> None:
        if origin is None:
            model.insert_child(joint, f'<origin xyz="{written(values)}"/>')
        else:
            model.set_attribute(origin, "xyz", written(values))

    frame = _link(joint, "parent")
    return Wheel(name, link, radius, slots, Slot(place, write), frame=frame, beside=sits_off(link))


def _link(joint: Node, tag: str) -> str:
    node = joint.child(tag)
    return "" if node is None else node.attributes.get("link", "")


def _is_link(node: Node, name: str) -> bool:
    return node.tag == "link" and node.attributes.get("name") == name


def _tilted(model: ModelFile, joints: list[Node], link: str) -> str:
    """Return the name of a joint above a link whose frame is rolled or pitched; empty where there is none."""
    for _ in range(len(joints) + 1):
        above = next((joint for joint in joints if _link(joint, "child") == link), None)
        if above is None:
            return ""
        origin, name = above.child("origin"), above.attributes.get("name", "")
        text = "0 0 0" if origin is None else origin.attributes.get("rpy", "0 0 0")
        roll, pitch, _yaw = numbers(text, f"{model.path}, origin of {name!r}", 3)
        if roll != 0.0 or pitch != 0.0:
            return name
        link = _link(above, "parent")
    raise RefusedError(f"{model.path}: found joints that form a loop above {link!r}; expected a tree; correct the file")
