"""Gazebo's SDF: radii of the wheels' collisions and visuals, the links' poses, and the drive plugin."""

from __future__ import annotations

from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions
from calib.coefficients.formats.model_file import ModelFile, Node, Slot, Wheel, named, patched, text_slot
from calib.coefficients.formats.urdf import link_radii, plugin_parameters, sits_off

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

    def stated(shape: Node) -> Slot | None:
        radius = shape.child("radius")
        return None if radius is None else text_slot(model, radius, f"radius of {name!r}", 1)

    radius, slots = link_radii(model, link, name, stated)
    pose, why = _pose(link)
    if pose is None:
        inside = _inside(model, link, name) if link.child("pose") is None else None
        return Wheel(name, link, radius, slots, inside, frame=(link.parent, ""), why_fixed=why)
    placed = text_slot(model, pose, f"pose of {name!r}")
    frame = pose.attributes.get("relative_to", "")
    position = Slot(placed.values[:3], lambda new: placed.write((*new, *placed.values[3:])))
    return Wheel(name, link, radius, slots, position, frame=(link.parent, frame), beside=sits_off(link))


def _child_link(joint: Node) -> Node | None:
    child = joint.child("child")
    links = () if joint.parent is None else joint.parent.children
    name = "" if child is None else child.text.strip()
    return next((node for node in links if node.tag == "link" and node.attributes.get("name") == name), None)


def _inside(model: ModelFile, link: Node, name: str) -> Slot | None:
    """Return the place of a wheel whose link states none: that of its collision; all poses inside and its joint move.

    None where a shape has no pose of its own, or a pose is relative to another frame.
    """
    shapes = [part for part in link.children if part.tag in ("collision", "visual", "inertial")]
    siblings = [] if link.parent is None else link.parent.children
    joints = [node for node in siblings if node.tag == "joint" and _child_link(node) is link and node.child("pose")]
    stated = [pose for part in (*shapes, *joints) if (pose := part.child("pose")) is not None]
    if (
        not shapes
        or len(stated) < len(shapes) + len(joints)
        or any("relative_to" in pose.attributes for pose in stated)
    ):
        return None
    poses = [text_slot(model, pose, f"pose of {name!r}", 6) for pose in stated]
    tags = [part.tag for part in shapes]
    old = poses[tags.index("collision") if "collision" in tags else tags.index("visual")].values[:3]

    def move(new: tuple[float, ...]) -> None:
        by = [after - before for after, before in zip(new, old, strict=True)]
        for pose in poses:
            pose.write((*(at + off for at, off in zip(pose.values, by, strict=False)), *pose.values[3:]))

    return Slot(old, move)


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
