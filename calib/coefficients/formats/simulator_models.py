"""Models of simulators: radii and places of the wheels in ROS's URDF, Gazebo's SDF and MuJoCo's MJCF, and plugins."""

from collections.abc import Callable
from functools import partial
from typing import Final

from calib.coefficients.formats import model_file
from calib.coefficients.formats.model_file import ModelFile, Node, Slot, Wheel, numbers, patched, text_slot, written
from calib.errors import RefusedError

#: elements that have a radius; of a geom of MJCF it is the first size
ROUND: Final = frozenset({"cylinder", "sphere", "capsule"})
#: attributes that turn a frame
TURNS: Final = ("quat", "axisangle", "xyaxes", "zaxis", "euler")


def _link_radii(
    model: ModelFile, link: Node | None, name: str, radius: Callable[[Node], Slot | None]
) -> tuple[float, tuple[Slot, ...]]:
    by_tag: dict[str, list[Slot]] = {"collision": [], "visual": []}
    for part in () if link is None else link.children:
        if part.tag in by_tag:
            by_tag[part.tag] += [slot for shape in part.walk() if shape.tag in ROUND and (slot := radius(shape))]
    contact = by_tag["collision"] or by_tag["visual"]
    if not contact:
        text = f"{model.path}: found no cylinder, sphere or capsule in the link of {name!r}; expected one with a radius"
        raise RefusedError(f"{text}; a mesh has none: add a collision cylinder")
    largest = max(slot.values[0] for slot in contact)
    return largest, tuple(slot for slots in by_tag.values() for slot in slots if slot.values[0] == largest)


def _off_zero(place: str) -> bool:
    return any(part.strip("-+0.") for part in place.split()[:3])


def _sits_off(link: Node | None) -> bool:
    for part in () if link is None else link.children:
        place = part.child("origin") or part.child("pose") if part.tag == "collision" else None
        if place is not None and _off_zero(place.attributes.get("xyz", place.text)):
            return True
    return False


def _of_urdf(model: ModelFile, name: str, option: str) -> Wheel:
    joints = [node for node in model.root.children if node.tag == "joint"]
    known = ((one, node) for node in joints for one in {node.attributes.get("name", ""), _link(node, "child")} - {""})
    joint = model_file.named(known, name, model.path, option)
    link = model.root.child("link", _link(joint, "child"))

    def stated(shape: Node) -> Slot | None:
        if "radius" not in shape.attributes:
            return None
        values = numbers(shape.attributes["radius"], f"{model.path}, radius of {name!r}", 1)
        return Slot(values, lambda new: model.set_attribute(shape, "radius", written(new)))

    radius, slots = _link_radii(model, link, name, stated)
    frame = _link(joint, "parent")
    tilted = _tilted(model, joints, frame)
    assert link is not None
    if tilted:
        return Wheel(name, link, radius, slots, None, why_fixed=f"since joint {tilted!r} above it is tilted")

    def write(values: tuple[float, ...]) -> None:
        if (origin := joint.child("origin")) is None:
            model.insert_child(joint, f'<origin xyz="{written(values)}"/>')
        else:
            model.set_attribute(origin, "xyz", written(values))

    place = Slot(_origin(model, joint, "xyz", name), write)
    return Wheel(name, link, radius, slots, place, frame=frame, beside=_sits_off(link))


def _origin(model: ModelFile, joint: Node, attribute: str, name: str) -> tuple[float, ...]:
    origin = joint.child("origin")
    text = "0 0 0" if origin is None else origin.attributes.get(attribute, "0 0 0")
    return numbers(text, f"{model.path}, origin of {name!r}", 3)


def _link(joint: Node, tag: str) -> str:
    node = joint.child(tag)
    return "" if node is None else node.attributes.get("link", "")


def _tilted(model: ModelFile, joints: list[Node], link: str) -> str:
    for _ in range(len(joints) + 1):
        above = next((joint for joint in joints if _link(joint, "child") == link), None)
        if above is None:
            return ""
        name = above.attributes.get("name", "")
        if any(_origin(model, above, "rpy", name)[:2]):
            return name
        link = _link(above, "parent")
    raise RefusedError(f"{model.path}: found joints that form a loop above {link!r}; expected a tree; correct the file")


def _of_sdf(model: ModelFile, name: str, option: str) -> Wheel:
    links = (
        (node.attributes["name"], node if node.tag == "link" else _child_link(node))
        for node in model.root.walk()
        if node.tag in ("link", "joint") and node.parent is not None and node.parent.tag == "model"
        if "name" in node.attributes
    )
    link = model_file.named(((known, link) for known, link in links if link is not None), name, model.path, option)

    def stated(shape: Node) -> Slot | None:
        radius = shape.child("radius")
        return None if radius is None else text_slot(model, radius, f"radius of {name!r}", 1)

    radius, slots = _link_radii(model, link, name, stated)
    pose, why = _pose(link)
    if pose is None:
        inside = _inside(model, link, name) if link.child("pose") is None else None
        return Wheel(name, link, radius, slots, inside, frame=(link.parent, ""), why_fixed=why)
    placed = text_slot(model, pose, f"pose of {name!r}")
    frame = pose.attributes.get("relative_to", "")
    position = Slot(placed.values[:3], lambda new: placed.write((*new, *placed.values[3:])))
    return Wheel(name, link, radius, slots, position, frame=(link.parent, frame), beside=_sits_off(link))


def _child_link(joint: Node) -> Node | None:
    child = joint.child("child")
    return None if child is None or joint.parent is None else joint.parent.child("link", child.text.strip())


def _inside(model: ModelFile, link: Node, name: str) -> Slot | None:
    shapes = [part for part in link.children if part.tag in ("collision", "visual", "inertial")]
    siblings = [] if link.parent is None else link.parent.children
    joints = [node for node in siblings if node.tag == "joint" and _child_link(node) is link and node.child("pose")]
    stated = [pose for part in (*shapes, *joints) if (pose := part.child("pose")) is not None]
    if not shapes or len(stated) < len(shapes) + len(joints):
        return None
    if any("relative_to" in pose.attributes for pose in stated):
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
    siblings = [] if link.parent is None else link.parent.children
    pose = link.child("pose")
    if pose is None:
        return None, "since its link has no pose"
    frame = pose.attributes.get("relative_to", "")
    joint = link.parent.child("joint", frame) if frame and link.parent is not None else None
    if joint is not None:
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


def _of_mjcf(model: ModelFile, name: str, option: str) -> Wheel:
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
    for turned in (node for node in body.ancestors() if set(TURNS) & set(node.attributes)):
        why = f"since the frame of {turned.attributes.get('name', turned.tag)!r} is turned"
        return Wheel(name, body, radius, slots, None, why_fixed=why)
    place = numbers(body.attributes.get("pos", "0 0 0"), f"{model.path}, pos of {name!r}", 3)
    position = Slot(place, lambda values: model.set_attribute(body, "pos", written(values)))
    off = any(_off_zero(_inherited(model, geom, "pos") or "") for geom, shape in sizes if shape[0] == radius)
    return Wheel(name, body, radius, slots, position, frame=body.parent, beside=off)


def _body(model: ModelFile, name: str, option: str) -> Node:
    world = model.root.child("worldbody")
    nodes = (node for node in (() if world is None else world.walk()) if "name" in node.attributes)
    bodies = (
        (node.attributes["name"], body)
        for node in nodes
        if node.tag in ("body", "joint", "geom")
        if (body := node if node.tag == "body" else node.parent) is not None and body.tag == "body"
    )
    return model_file.named(bodies, name, model.path, option)


def _shape(model: ModelFile, geom: Node) -> tuple[float, ...] | None:
    if _inherited(model, geom, "type") not in ROUND:
        return None
    size = _inherited(model, geom, "size")
    return None if size is None else numbers(size, f"{model.path}, size of geom {geom.attributes.get('name', '')!r}")


def _inherited(model: ModelFile, geom: Node, attribute: str) -> str | None:
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
    if name is None or name == "main":
        return node.parent is not None and node.parent.tag != "default"
    return node.attributes.get("class") == name


urdf: Final = partial(patched, root_tag="robot", wheel=_of_urdf)
sdf: Final = partial(patched, root_tag="sdf", wheel=_of_sdf)
mjcf: Final = partial(patched, root_tag="mujoco", wheel=_of_mjcf)
