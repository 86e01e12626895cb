"""Gazebo's SDF: radii of the wheels' collisions and visuals, the links' poses, and the drive plugin."""

from __future__ import annotations

from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions
from calib.coefficients.formats.model_file import ModelFile, Node, Slot, Wheel, named, numbers, patched, written
from calib.coefficients.formats.urdf import ROUND, plugin_parameters
from calib.errors import RefusedError

#: see `calib.coefficients.formats`
AXLE_ONLY: Final = True
PATCHES_MODEL: Final = True


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return a copy of the model with the radii, the track and the axles' heights of the coefficient file.

    Raises BadInputError where the model or a wheel's name cannot be used; RefusedError where a wheel has no radius.
    """
    return patched(file, options, "sdf", _wheel, plugin_parameters)


def _wheel(model: ModelFile, name: str, option: str) -> Wheel:
    candidates: dict[str, list[Node]] = {}
    for node in model.root.walk():
        if node.tag in ("link", "joint") and node.parent is not None and node.parent.tag == "model":
            link = node if node.tag == "link" else _child_link(node)
            if link is not None and "name" in node.attributes:
                links = candidates.setdefault(node.attributes["name"], [])
                links += [] if link in links else [link]
    link = named(candidates, name, model.path, option)
    radius, slots = _radii(model, link, name)
    pose, why = _pose(link)
    if pose is None:
        return Wheel(name, radius, slots, None, why_fixed=why)
    values = numbers(pose.text, f"{model.path}, pose of {name!r}")
    frame = pose.attributes.get("relative_to", "")
    position = Slot(values[:3], lambda new: model.set_text(pose, written((*new, *values[3:]))))
    return Wheel(name, radius, slots, position, frame=(link.parent, frame))


def _child_link(joint: Node) -> Node | None:
    child = joint.child("child")
    links = () if joint.parent is None else joint.parent.children
    name = "" if child is None else child.text.strip()
    return next((node for node in links if node.tag == "link" and node.attributes.get("name") == name), None)


def _radii(model: ModelFile, link: Node, name: str) -> tuple[float, tuple[Slot, ...]]:
    found: dict[str, list[Slot]] = {"collision": [], "visual": []}
    for part in link.children:
        if part.tag not in found:
            continue
        for shape in (node for node in part.walk() if node.tag in ROUND):
            stated = shape.child("radius")
            if stated is None:
                continue
            values = numbers(stated.text, f"{model.path}, radius of {name!r}", 1)
            write = lambda new, stated=stated: model.set_text(stated, written(new))  # noqa: E731
            found[part.tag].append(Slot(values, write))
    contact = found["collision"] or found["visual"]
    if not contact:
        raise RefusedError(
            f"{model.path}: found no cylinder, sphere or capsule in the link of {name!r}; expected one with "
            "a radius; a mesh has none: add a collision cylinder"
        )
    radius = max(slot.values[0] for slot in contact)
    return radius, tuple(slot for slots in found.values() for slot in slots if slot.values[0] == radius)


def _pose(link: Node) -> tuple[Node | None, str]:
    """Return the element that places a wheel's link, that of its joint where the link sits on it; else why not."""
    siblings = [] if link.parent is None else link.parent.children
    pose = link.child("pose")
    if pose is None:
        return None, "since its link has no pose"
    frame = pose.attributes.get("relative_to", "")
    joint = next((node for node in siblings if node.tag == "joint" and node.attributes.get("name") == frame), None)
    if frame and joint is not None:
        pose = joint.child("pose")
        if pose is None or not pose.attributes.get("relative_to"):
            return None, f"since joint {frame!r}, on which it sits, has no pose in another frame"
        frame = pose.attributes["relative_to"]
    bases = [node for node in siblings if node.attributes.get("name") == frame] if frame else []
    for node in (*bases, *link.ancestors()):
        stated = node.child("pose")
        turned = () if stated is None else stated.text.split()[3:5]
        if any(part.strip("-+0.") for part in turned):
            return None, f"since the frame of {node.attributes.get('name', node.tag)!r} is tilted"
    return pose, ""
