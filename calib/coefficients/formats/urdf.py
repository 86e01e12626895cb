"""ROS's URDF: radii of the wheels' collisions and visuals, the joints' places, ros2_control and drive plugins."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions
from calib.coefficients.formats.model_file import (
    ModelFile,
    Node,
    Slot,
    Wheel,
    attribute_slot,
    link_radii,
    named,
    numbers,
    patched,
    sits_off,
    written,
)
from calib.errors import RefusedError

#: see `calib.coefficients.formats`
AXLE_ONLY: Final = True
PATCHES_MODEL: Final = True


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
    if tilted:
        return Wheel(name, radius, slots, None, why_fixed=f"since joint {tilted!r} above it is tilted")
    origin = joint.child("origin")
    text = "0 0 0" if origin is None else origin.attributes.get("xyz", "0 0 0")
    place = numbers(text, f"{model.path}, origin of {name!r}", 3)

    def write(values: tuple[float, ...]) -> None:
        if origin is None:
            model.insert_child(joint, f'<origin xyz="{written(values)}"/>')
        else:
            model.set_attribute(origin, "xyz", written(values))

    frame = _link(joint, "parent")
    return Wheel(name, radius, slots, Slot(place, write), frame=frame, beside=sits_off(link))


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
