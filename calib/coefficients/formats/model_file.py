"""A simulator's model file: read safely, changed in single attributes and texts, other bytes as they were.

Documents with a DOCTYPE are refused: entities could grow without end or name other files.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NoReturn
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from calib.coefficients import formats
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, LoadPair, accepted_lines, ascii_line, radii_m
from calib.errors import BadFileError, BadInputError, CalibError, RefusedError
from calib.types import grouped

#: bytes; a model that is longer has its meshes inside
LARGEST: Final = 50_000_000
#: significant digits of a length: a nanometre of a metre
DIGITS: Final = 9
#: a radius off by more than this factor is in another unit, or another wheel's
FACTOR: Final = 2.0
_ATTRIBUTE: Final = re.compile(rb"""\s+([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(slots=True, eq=False)
class Node:
    """An element of the document, with the bytes that it came from."""

    tag: str
    attributes: dict[str, str]
    parent: "Node | None"
    #: offsets of its start tag, of the end of that tag, and of its end tag
    start: int
    tag_end: int = 0
    close: int = 0
    children: "list[Node]" = field(default_factory=list)
    text: str = ""

    def walk(self) -> "Iterator[Node]":
        """Yield the element and all below it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()

    def child(self, tag: str, name: str | None = None) -> "Node | None":
        """Return the first child of that tag, and name if given, or None."""
        alike = (child for child in self.children if child.tag == tag)
        return next((child for child in alike if name is None or child.attributes.get("name") == name), None)

    def ancestors(self) -> "Iterator[Node]":
        """Yield the parents, the nearest first."""
        if self.parent is not None:
            yield self.parent
            yield from self.parent.ancestors()


class ModelFile:
    """A document with the changes asked for so far."""

    def __init__(self, path: Path, root_tag: str) -> None:
        self.path = path
        try:
            with path.open("rb") as file:
                self.data = file.read(LARGEST + 1)
        except OSError as error:
            raise BadFileError(path, error.strerror or "no file", "a model file", "give the path of one") from error
        if len(self.data) > LARGEST:
            raise BadFileError(path, "more than 50 MB", "a model file", "keep meshes in files of their own")
        self._changes: dict[tuple[int, int], bytes] = {}
        self.root = self._parsed()
        if self.root.tag != root_tag:
            raise BadFileError(path, f"<{self.root.tag}>", f"<{root_tag}>", "choose the format that --to names")

    def _parsed(self) -> Node:
        parser = expat.ParserCreate(encoding="utf-8")
        open_nodes: list[Node] = []
        roots: list[Node] = []

        def start(tag: str, attributes: dict[str, str]) -> None:
            at = parser.CurrentByteIndex
            node = Node(tag, attributes, open_nodes[-1] if open_nodes else None, at, self._tag_end(at))
            (open_nodes[-1].children if open_nodes else roots).append(node)
            open_nodes.append(node)

        def end(_tag: str) -> None:
            open_nodes.pop().close = parser.CurrentByteIndex

        def text(data: str) -> None:
            if open_nodes:
                open_nodes[-1].text += data

        def refused(*_args: object) -> NoReturn:
            words = ("a DOCTYPE, or an entity", "a model file without one", "remove it; a model needs neither")
            raise BadFileError(self.path, *words, row=parser.CurrentLineNumber)

        parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
        parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = parser.ExternalEntityRefHandler = refused
        try:
            parser.Parse(self.data, True)
        except expat.ExpatError as error:
            actual = expat.ErrorString(error.code)
            raise BadFileError(self.path, actual, "XML in UTF-8", "correct the file", row=error.lineno) from error
        return roots[0]

    def _tag_end(self, at: int) -> int:
        end = at + 1 + len(re.match(rb"[^\s/>]+", self.data[at + 1 : at + 1001]).group())  # type: ignore[union-attr]
        while match := _ATTRIBUTE.match(self.data, end):
            end = match.end()
        return end

    def set_attribute(self, node: Node, name: str, value: str) -> None:
        """Set an attribute, a new one at the end of the tag."""
        node.attributes[name] = value
        at = node.start + 1 + len(node.tag.encode())
        while match := _ATTRIBUTE.match(self.data, at):
            if match[1] == name.encode():
                quote = match[2][:1]
                self._changes[match.start(2), match.end(2)] = quote + value.encode() + quote
                return
            at = match.end()
        self._insert(node.tag_end, f" {name}={quoteattr(value)}".encode())

    def set_text(self, node: Node, value: str) -> None:
        """Set the text of an element without children; white space around it stays."""
        begin = self.data.index(b">", node.tag_end) + 1
        between = self.data[begin : node.close]
        if between.strip() != node.text.strip().encode():
            fault = f"{self.path}: found <{node.tag}> with comments or entities in its number"
            raise RefusedError(f"{fault}; expected a plain number; write it so")
        node.text = value
        left, right = len(between) - len(between.lstrip()), len(between.rstrip())
        self._changes[begin + left, begin + right] = value.encode()

    def insert_child(self, node: Node, text: str) -> None:
        """Insert an element as the first child of a `node` with both tags."""
        self._insert(self.data.index(b">", node.tag_end) + 1, text.encode())

    def _insert(self, at: int, data: bytes) -> None:
        self._changes[at, at] = self._changes.get((at, at), b"") + data

    def render(self, comment: str) -> bytes:
        """Return the document with the changes, and a comment as the root's first child."""
        head = self.data.index(b">", self.root.tag_end) + 1
        self._insert(head, f"\n  <!-- {comment.replace('--', '- -')} -->".encode())
        parts, at = [], 0
        for (begin, end), data in sorted(self._changes.items()):
            parts += [self.data[at:begin], data]
            at = end
        return b"".join([*parts, self.data[at:]])


@dataclass(frozen=True, slots=True)
class Slot:
    """A number, or a vector, in the model file, and how to write another in its place."""

    values: tuple[float, ...]
    write: Callable[[tuple[float, ...]], None]


def text_slot(model: ModelFile, node: Node, where: str, count: int | None = None) -> Slot:
    """Return the numbers of an element's text; raises BadInputError as `numbers` does."""
    return Slot(numbers(node.text, f"{model.path}, {where}", count), lambda new: model.set_text(node, written(new)))


@dataclass(frozen=True, slots=True)
class Wheel:
    """A wheel of the model: its radius, everywhere that it stands, and where the wheel sits."""

    name: str
    #: the link or body that rolls
    node: Node
    radius_m: float
    radii: tuple[Slot, ...]
    #: x, y, z in the frame `frame`; None where it cannot be moved, and why
    position: Slot | None
    frame: object = None
    why_fixed: str = ""
    #: whether its round shape sits off the frame that is moved
    beside: bool = False


#: model, wheel's name, and the option that gave it -> the wheel
FindWheel = Callable[[ModelFile, str, str], Wheel]


@dataclass(frozen=True, slots=True)
class _NewWheels:
    left_m: float
    right_m: float
    track_m: float


def numbers(text: str, where: str, count: int | None = None) -> tuple[float, ...]:
    """Return the finite numbers of a text, `count` of them if given; an open macro has none."""
    try:
        values = tuple(float(part) for part in text.split())
    except ValueError:
        values = ()
    if not values or not all(map(math.isfinite, values)) or count not in (None, len(values)):
        expected = "numbers" if count is None else f"{count} numbers"
        hint = "; expand the macros first (xacro MODEL > FILE)" if "${" in text else "; correct it"
        raise BadInputError(f"{where}: found {text[:60]!r}; expected {expected}{hint}")
    return values


def written(values: tuple[float, ...]) -> str:
    """Return numbers as text."""
    return " ".join(f"{value:.{DIGITS}g}" for value in values)


def _set_wheels(left: Wheel, right: Wheel, new: _NewWheels) -> tuple[str, ...]:
    for wheel, radius in ((left, new.left_m), (right, new.right_m)):
        if not 1.0 / FACTOR < wheel.radius_m / radius < FACTOR:
            raise RefusedError(
                f"wheel {wheel.name}: found a radius of {wheel.radius_m:g} in the model; expected about {radius:.4g} "
                "m; give the joints of the calibrated wheels, and a model in metres"
            )
        for slot in wheel.radii:
            slot.write((radius, *slot.values[1:]))
    notes = [f"{wheel.name}: not moved, {wheel.why_fixed}" for wheel in (left, right) if wheel.position is None]
    if left.position is None or right.position is None:
        return (*notes, "track and axle heights: as they were")
    if left.frame != right.frame:
        return ("track and axle heights: as they were, since the wheels hang on different parents",)
    (xl, yl, zl), (xr, yr, zr) = left.position.values, right.position.values
    apart = math.hypot(xl - xr, yl - yr)
    if apart == 0.0:
        return ("track and axle heights: as they were, since both wheels sit at the same place",)
    swapped = f"{left.name}: sits right of {right.name}, unless the model drives along -x; they look swapped"
    grow = 0.5 * (new.track_m - apart) / apart
    dx, dy = grow * (xl - xr), grow * (yl - yr)
    left.position.write((xl + dx, yl + dy, zl + new.left_m - left.radius_m))
    right.position.write((xr - dx, yr - dy, zr + new.right_m - right.radius_m))
    return (swapped,) * (yr - yl > 0.5 * apart) + tuple(
        f"{wheel.name}: its round shape sits off its frame; the track is that between the frames, check that between "
        "the shapes"
        for wheel in (left, right)
        if wheel.beside
    )


def named(candidates: Iterable[tuple[str, Node]], name: str, path: Path, option: str) -> Node:
    """Return the only element of a name, of (name, element); raises BadInputError."""
    known = grouped(candidates)
    nodes = set(known.get(name, ()))
    if len(nodes) == 1:
        return nodes.pop()
    if nodes:
        raise BadInputError(f"{path}: found {len(nodes)} elements named {name!r}; expected one; rename them")
    listed = ", ".join(sorted(known)[:20]) or "none with a name"
    raise BadInputError(f"{option}: found {name!r}; expected a wheel of {path.name}: {listed}; choose one of them")


#: share of its radius within which another wheel is like those set
LIKE_RADIUS: Final = 0.1
#: types of a joint that turns; MuJoCo's where none is stated
TURNING: Final = frozenset({"continuous", "revolute", "hinge"})


def _further_wheels(model: ModelFile, set_ones: tuple[Wheel, Wheel], wheel: FindWheel) -> tuple[str, ...]:
    radius_m = set_ones[0].radius_m
    seen, others = [known.node for known in set_ones], []
    for joint in model.root.walk():
        if joint.tag != "joint" or joint.attributes.get("type", "hinge") not in TURNING or joint.parent is None:
            continue
        with suppress(CalibError):
            candidate = wheel(model, joint.attributes.get("name") or joint.parent.attributes.get("name", ""), "")
            if candidate.node not in seen and abs(candidate.radius_m - radius_m) <= LIKE_RADIUS * radius_m:
                seen.append(candidate.node)
                others.append(f"{candidate.name} (radius {candidate.radius_m:g} m)")
    note = f"not set: {', '.join(others)}; for a second pair export again, --into the copy, and name its joints"
    return (note,) if others else ()


#: parameters of drive plugins and of ros2_control, and what they are of radii and track
PLUGIN_KEYS: Final[dict[str, Callable[[_NewWheels], float]]] = {
    **dict.fromkeys(("wheel_radius", "wheelRadius"), lambda new: 0.5 * (new.left_m + new.right_m)),
    "left_wheel_radius": lambda new: new.left_m,
    "right_wheel_radius": lambda new: new.right_m,
    **dict.fromkeys(("wheel_diameter", "wheelDiameter"), lambda new: new.left_m + new.right_m),
    **dict.fromkeys(("wheel_separation", "wheelSeparation"), lambda new: new.track_m),
}


def _plugin_parameters(model: ModelFile) -> Iterator[Node]:
    for node in model.root.walk():
        if not node.children and any(above.tag in ("plugin", "ros2_control") for above in node.ancestors()):
            yield node


def patched(file: CoefficientFile, options: ExportOptions, root_tag: str, wheel: FindWheel) -> tuple[Artifact, ...]:
    """Return the user's model, wheels and drive plugins set, and what it cannot express; see `FindWheel`.

    Raises BadInputError where model, names or loads cannot be used.
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
    reference = LoadPair(file.wheels.left.reference_load.value, file.wheels.right.reference_load.value)
    asked = options.loads[0] if options.loads else LoadPair(*formats.within_N(file, reference))
    new = _NewWheels(*radii_m(file, asked), file.vehicle.track.value)
    pair = LoadPair(*formats.within_N(file, asked))
    clamped = (pair.left_N, pair.right_N) != (asked.left_N, asked.right_N)
    left, right = wheel(model, options.left, "--left"), wheel(model, options.right, "--right")
    notes = [*_set_wheels(left, right, new), *_further_wheels(model, (left, right), wheel)]
    for node in _plugin_parameters(model):
        name = node.attributes.get("name", "") if node.tag == "param" else node.tag
        if name in PLUGIN_KEYS:
            text_slot(model, node, name, 1).write((PLUGIN_KEYS[name](new),))
            if new.left_m != new.right_m and not any(word in name for word in ("left", "right", "eparation")):
                lost = f"one radius for both wheels, their ratio {new.right_m / new.left_m:.6f} is lost"
                notes.append(f"{name} of a plugin: {lost}")
    notes += _beyond(file, pair)
    comment = (
        f"calib: wheels at {pair.left_N:g} N left, {pair.right_N:g} N right",
        *([f"CLAMPED from {asked.left_N:g} N left, {asked.right_N:g} N right"] if clamped else []),
        f"coefficient file {file.checksum[: formats.CHECKSUM_DIGITS]}",
        f"campaign {ascii_line(file.name)}",
        *(["SIMULATED DATA"] if file.simulated else []),
        *accepted_lines(file),
    )
    return (Artifact(options.model.name, model.render("; ".join(comment)), tuple(dict.fromkeys(notes))),)


def _beyond(file: CoefficientFile, pair: LoadPair) -> Iterator[str]:
    for side, law, load in (("left", file.law.left, pair.left_N), ("right", file.law.right, pair.right_N)):
        if law.slope_m_per_N != 0.0:
            by = f"the {side} radius follows the load by {1e6 * law.slope_m_per_N:.3g} µm/N"
            yield f"not in the model: {by}; the model has that at {load:g} N"
    for effect in file.effects:
        yield f"not in the model: effect {effect.effect}; calib.runtime adds it to the motion of a simulator's loop"
    for name, value in file.together.items():
        if value != 0.0 and name.startswith(("sensor_", "delay", "steering_")):
            yield f"not in the model: {name} {value:.6g}"
