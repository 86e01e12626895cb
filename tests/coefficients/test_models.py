"""A simulator's model gets radii, track and axle heights; all other bytes stay, and nothing outside is read."""

from __future__ import annotations

import difflib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from calib.campaign.settings import Encoder
from calib.cli.main import run
from calib.coefficients.build import Header, export, from_law
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, LoadPair
from calib.errors import BadInputError, CalibError
from calib.radius.law import RadiusLaw
from calib.vehicle import Vehicle

MODELS = Path(__file__).parent / "models"
EXAMPLE = Path(__file__).parents[2] / "examples" / "mujoco_agv" / "agv.xml"
LEFT, RIGHT, TRACK = 0.0994, 0.1003, 0.705
#: digits that a model file gets
WRITTEN = 1e-8
#: contacts give way and creep: the change of an end pose that new radii make, relative to rigid wheels
CREEP = 0.05


@pytest.fixture
def coefficients(law: RadiusLaw) -> CoefficientFile:
    left, right = (
        replace(wheel, radius_ref_m=radius, slope_m_per_N=0.0)
        for wheel, radius in ((law.left, LEFT), (law.right, RIGHT))
    )
    return from_law(RadiusLaw(left, right), Vehicle(track_m=TRACK), Encoder(), Header("lab", simulated=False))


def _export(file: CoefficientFile, to: str, model: Path, left: str, right: str) -> Artifact:
    (artifact,) = export(file, to, options=ExportOptions(model=model, left=left, right=right))
    return artifact


def _numbers(text: str | None) -> list[float]:
    return [float(part) for part in (text or "").split()]


def test_urdf(coefficients: CoefficientFile) -> None:
    artifact = _export(coefficients, "urdf", MODELS / "differential.urdf", "left_joint", "wheel_r")
    root = ElementTree.fromstring(artifact.data)
    radii = {
        link.get("name"): [float(x.get("radius", 0)) for x in link.iter() if "radius" in x.attrib] for link in root
    }
    # visual and collision follow, the hub does not
    assert radii["wheel_l"] == [LEFT, 0.03, LEFT]
    assert radii["wheel_r"] == [RIGHT]
    places = {joint.get("name"): joint.find("origin") for joint in root.findall("joint")}
    left, right = (_numbers(places[name].get("xyz")) for name in ("left_joint", "right_joint"))  # type: ignore[union-attr]
    # the chassis keeps its height: each axle is a radius above the floor
    assert left == pytest.approx([0.0, TRACK / 2, LEFT - 0.1], abs=WRITTEN)
    assert right == pytest.approx([0.0, -TRACK / 2, RIGHT - 0.1], abs=WRITTEN)
    texts = {x.get("name", x.tag): x.text for x in root.iter() if x.text and x.tag.startswith(("wheel_", "param"))}
    assert float(texts["wheel_separation"] or 0) == pytest.approx(TRACK)
    assert float(texts["wheel_diameter"] or 0) == pytest.approx(LEFT + RIGHT)
    assert float(texts["wheel_radius"] or 0) == pytest.approx((LEFT + RIGHT) / 2)
    assert any("one radius for both wheels" in note for note in artifact.notes)


def test_sdf(coefficients: CoefficientFile) -> None:
    artifact = _export(coefficients, "sdf", MODELS / "tricycle.sdf", "left_hinge", "right")
    root = ElementTree.fromstring(artifact.data)
    found = {link.get("name"): [float(x.text or 0) for x in link.iter("radius")] for link in root.iter("link")}
    assert found == {"chassis": [], "left": [LEFT], "right": [RIGHT]}
    hinges = {joint.get("name"): _numbers(joint.findtext("pose")) for joint in root.iter("joint")}
    assert hinges["left_hinge"] == pytest.approx([0.0, TRACK / 2, LEFT - 0.1, -1.5707, 0, 0], abs=WRITTEN)
    assert hinges["right_hinge"] == pytest.approx([0.0, -TRACK / 2, RIGHT - 0.1, -1.5707, 0, 0], abs=WRITTEN)
    assert float(root.findtext(".//wheel_separation", "")) == TRACK


def test_sdf_whose_links_have_no_pose(coefficients: CoefficientFile) -> None:
    """Parts placed in the model's frame, as robots for Gazebo have them: all of a wheel moves with its joint."""
    artifact = _export(coefficients, "sdf", MODELS / "poses_inside.sdf", "left_joint", "wheel_r")
    root = ElementTree.fromstring(artifact.data)
    left, right = [0.0, TRACK / 2, LEFT - 0.01], [0.0, -TRACK / 2, RIGHT - 0.01]
    poses = {
        node.get("name", node.tag): _numbers(node.findtext("pose"))
        for node in root.iter()
        if node.find("pose") is not None
    }
    assert poses["left_joint"] == pytest.approx([*left, -1.57, 0, 0], abs=WRITTEN)
    assert poses["right_joint"] == pytest.approx([*right, -1.57, 0, 0], abs=WRITTEN)
    assert poses["inertial"] == poses["left_joint"]
    assert poses["rim"][:3] == pytest.approx([0.0, TRACK / 2 + 0.01, LEFT - 0.01], abs=WRITTEN)
    assert [float(x.text or 0) for link in root.iter("link") for x in link.iter("radius")] == [LEFT, RIGHT]
    assert not any("as they were" in note or "not moved" in note for note in artifact.notes)


def test_wheels_of_a_second_pair_are_named_as_left(coefficients: CoefficientFile, tmp_path: Path) -> None:
    """Four driven wheels: the joints that were not given are listed, and a second export sets them."""
    text = (MODELS / "differential.urdf").read_text()
    wheel = '<link name="{0}"><collision><geometry><cylinder radius="0.1" length="0.04"/></geometry></collision></link>'
    joint = (
        '<joint name="{0}_joint" type="continuous"><parent link="base"/><child link="{0}"/>'
        '<origin xyz="0.5 {1} 0"/></joint>'
    )
    front = "".join(part.format(name, y) for name, y in (("fl", 0.35), ("fr", -0.35)) for part in (wheel, joint))
    (tmp_path / "four.urdf").write_text(text.replace("</robot>", f"{front}</robot>"))
    artifact = _export(coefficients, "urdf", tmp_path / "four.urdf", "left_joint", "right_joint")
    (note,) = (note for note in artifact.notes if note.startswith("not set: "))
    assert "fl_joint (radius 0.1 m), fr_joint (radius 0.1 m)" in note
    assert b'<link name="fl"><collision><geometry><cylinder radius="0.1"' in artifact.data
    (tmp_path / "copy.urdf").write_bytes(artifact.data)
    again = _export(coefficients, "urdf", tmp_path / "copy.urdf", "fl_joint", "fr_joint")
    assert again.data.count(b'radius="0.0994"') == 2
    alone = _export(coefficients, "urdf", MODELS / "differential.urdf", "left_joint", "right_joint")
    assert not any(note.startswith("not set: ") for note in alone.notes)


def test_every_other_byte_is_as_it_was(coefficients: CoefficientFile) -> None:
    """Formatting, quotes, comments and line ends stay; only lines that hold a number of a wheel change."""
    for to, model, left, right in (
        ("urdf", MODELS / "differential.urdf", "left_joint", "right_joint"),
        ("sdf", MODELS / "tricycle.sdf", "left", "right"),
        ("mjcf", EXAMPLE, "left", "right"),
    ):
        before, after = model.read_bytes().decode(), _export(coefficients, to, model, left, right).data.decode()
        kept = [line[2:] for line in difflib.ndiff(before.splitlines(True), after.splitlines(True)) if line[0] == " "]
        gone = [line for line in before.splitlines(True) if line not in kept]
        words = ("radius", "wheel_", "pos", "xyz", "0.1 <", "diameter")
        assert gone and all(any(word in line for word in words) for line in gone), gone
        assert "sha256" in after and after.count("<!--") == before.count("<!--") + 1


def test_windows_line_ends_and_a_mark_of_utf8_stay(coefficients: CoefficientFile, tmp_path: Path) -> None:
    model = tmp_path / "m.urdf"
    model.write_bytes(b"\xef\xbb\xbf" + (MODELS / "differential.urdf").read_bytes().replace(b"\n", b"\r\n"))
    data = _export(coefficients, "urdf", model, "left_joint", "right_joint").data
    assert data.startswith(b"\xef\xbb\xbf<?xml") and data.count(b"\r\n") == model.read_bytes().count(b"\r\n")
    assert b'radius="0.0994"' in data


MJCF = """<mujoco>
  <default>
    <geom size="0.2"/>
    <default class="tyre"><geom type="cylinder" size="0.1 0.02"/>
      <default class="soft"><geom solref="0.01 1"/></default>
    </default>
  </default>
  <worldbody>
    <body name="car" childclass="tyre" {turned}>
      <body name="l" pos="0 0.35 0"><joint name="lj"/><geom class="soft"/><geom type="box" size="1 1 1"/></body>
      <body name="r" pos="0 -0.35 0"><joint name="rj" axis="0 1 0"/><geom/></body>
      <body name="m" pos="0 -0.35 0"><geom type="mesh" mesh="x"/></body>
    </body>
  </worldbody>
</mujoco>
"""


def test_a_shape_off_its_frame_is_pointed_out(coefficients: CoefficientFile, tmp_path: Path) -> None:
    """The track lies between the shapes on the ground: where they sit off their bodies, it has to be checked."""
    model = tmp_path / "car.xml"
    text = MJCF.format(turned="")
    model.write_text(text.replace('<joint name="rj" axis="0 1 0"/><geom/>', '<joint name="rj"/><geom pos="0 0 .01"/>'))
    notes = _export(coefficients, "mjcf", model, "lj", "rj").notes
    assert [note for note in notes if "off its frame" in note] == [
        "rj: its round shape sits off its frame; the track is that between the frames, check that between the shapes"
    ]
    model.write_text(text)
    assert not any("off its frame" in note for note in _export(coefficients, "mjcf", model, "lj", "rj").notes)


def test_mjcf_sizes_come_from_their_classes(coefficients: CoefficientFile, tmp_path: Path) -> None:
    model = tmp_path / "car.xml"
    model.write_text(MJCF.format(turned=""))
    root = ElementTree.fromstring(_export(coefficients, "mjcf", model, "lj", "r").data)
    sizes = {
        body.get("name"): [_numbers(geom.get("size")) for geom in body.findall("geom")] for body in root.iter("body")
    }
    assert sizes["l"] == [[LEFT, 0.02], [1.0, 1.0, 1.0]]
    assert sizes["r"] == [[RIGHT, 0.02]]


def test_a_turned_frame_keeps_its_places_and_says_so(coefficients: CoefficientFile, tmp_path: Path) -> None:
    model = tmp_path / "car.xml"
    model.write_text(MJCF.format(turned='euler="0 90 0"'))
    artifact = _export(coefficients, "mjcf", model, "lj", "rj")
    assert 'pos="0 0.35 0"' in artifact.data.decode()
    assert any("'car' is turned" in note for note in artifact.notes)


def test_mujoco_drives_the_patched_model_as_the_corrected_odometry_says(
    coefficients: CoefficientFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the patch changes at the end of a path is what rigid wheels of these radii and this track change."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    import agv  # type: ignore[import-not-found]
    import make_campaign as making  # type: ignore[import-not-found]

    model = tmp_path / "agv.xml"
    model.write_bytes(_export(coefficients, "mjcf", EXAMPLE, "left", "right").data)
    for pieces in (making.ROUTES["corridor"], making.ROUTES["turn_left"]):
        log = making.log_of(pieces, 0.6, True)
        angles = log[:, 1:] * [2 * np.pi / making.COUNTS] * [1.0, 1.0, making.COUNTS / 2 / np.pi]
        driven, rigid = [], []
        for path, (left, right, track) in ((EXAMPLE, (0.1, 0.1, 0.7)), (model, (LEFT, RIGHT, TRACK))):
            steps = np.diff(angles[:, :2], axis=0) * [left, right]
            turn = (steps[:, 1] - steps[:, 0]) / track
            # the front wheel is steered as these wheels turn, so that no wheel is dragged
            way = np.maximum(steps.mean(axis=1), 1e-6)
            steered = np.column_stack([angles[:, :2], np.append(np.arctan(making.WHEELBASE_M * turn / way), 0.0)])
            driven.append(agv.drive(mujoco.MjModel.from_xml_path(str(path)), log[:, 0], steered, log[-1, 0]))
            middle = np.cumsum(turn) - 0.5 * turn
            rigid.append([steps.mean(axis=1) @ np.cos(middle), steps.mean(axis=1) @ np.sin(middle), turn.sum()])
        change, expected = np.subtract(*driven[::-1]), np.subtract(*rigid[::-1])
        assert np.abs(change - expected).max() < CREEP * np.abs(expected).max()


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>',
        '<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
    ],
)
def test_entities_and_externals_are_refused(coefficients: CoefficientFile, tmp_path: Path, head: str) -> None:
    model = tmp_path / "m.urdf"
    model.write_text((MODELS / "differential.urdf").read_text().replace("<!-- a vehicle, by hand -->", head))
    with pytest.raises(CalibError, match=r"row 2: found a DOCTYPE"):
        _export(coefficients, "urdf", model, "left_joint", "right_joint")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('radius="0.1" length', 'radius="${r}" length', "xacro"),
        ('radius="0.1"', 'radius="100"', "metres"),
        ('<sphere radius="0.1"/>', '<mesh filename="w.stl"/>', "a mesh has none"),
        ("</robot>", "", "no element found"),
        ("a vehicle, by hand", "by hand: \ud800", "UTF-8"),
        ("right_joint", "left_joint", "2 elements named"),
        (" 0.7 </wheel", " 0.<!-- x -->7 </wheel", "comments"),
    ],
)
def test_a_model_that_cannot_be_patched_is_refused(
    coefficients: CoefficientFile, tmp_path: Path, old: str, new: str, message: str
) -> None:
    model = tmp_path / "m.urdf"
    text = (MODELS / "differential.urdf").read_text().replace(old, new)
    model.write_text(text, errors="surrogatepass")
    right = "wheel_r" if "left_joint" in new else "right_joint"
    with pytest.raises(CalibError, match=message):
        _export(coefficients, "urdf", model, "left_joint", right)


@pytest.mark.parametrize("to", ["mjcf", "urdf", "sdf"])
def test_a_model_states_the_load_at_which_its_radius_holds(coefficients: CoefficientFile, to: str) -> None:
    """A load that was not measured is named as such, and nothing says that the radius is that under it."""
    names = {
        "mjcf": (EXAMPLE, "left", "right"),
        "urdf": (MODELS / "differential.urdf", "left_joint", "wheel_r"),
        "sdf": (MODELS / "tricycle.sdf", "left_hinge", "right"),
    }
    model, left, right = names[to]
    file, law = coefficients.changed(outside="clamp"), coefficients.law
    far = ExportOptions(loads=(LoadPair(4900.0, 4900.0),), model=model, left=left, right=right)
    (artifact,) = export(file, to, options=far)
    text = artifact.data.decode()
    assert f"wheels at {law.left.load_max_N:g} N left, {law.right.load_max_N:g} N right" in text
    assert "CLAMPED from 4900 N left, 4900 N right" in text
    assert not any("at 4900 N" in note for note in artifact.notes)
    near = ExportOptions(loads=(LoadPair(500.0, 700.0),), model=model, left=left, right=right)
    inside = export(file, to, options=near)[0].data.decode()
    assert "wheels at 500 N left, 700 N right" in inside and "CLAMPED" not in inside
    wheels = coefficients.to_dict()["wheels"]
    wheels["left"]["valid_load"]["min"]["value"] = 333.0
    usual = ExportOptions(model=model, left=left, right=right)
    unasked = export(coefficients.changed(wheels=wheels), to, options=usual)[0].data.decode()
    assert "wheels at 333 N left, 300 N right" in unasked and "CLAMPED" not in unasked


def test_names_and_loads_are_checked(file: CoefficientFile) -> None:
    model = MODELS / "differential.urdf"
    with pytest.raises(BadInputError, match=r"--left: found 'wheel_left'; expected a wheel .*left_joint"):
        _export(file, "urdf", model, "wheel_left", "right_joint")
    with pytest.raises(BadInputError, match="two wheels"):
        _export(file, "urdf", model, "left_joint", "left_joint")
    with pytest.raises(BadInputError, match="--into MODEL"):
        export(file, "urdf")
    options = ExportOptions(model=model, left="left_joint", right="right_joint")
    with pytest.raises(BadInputError, match="several loads"):
        export(file, "urdf", replace(options, loads=(LoadPair(300.0, 300.0), LoadPair(500.0, 500.0))))
    with pytest.raises(CalibError, match="<robot>; expected <sdf>"):
        _export(file, "sdf", model, "left_joint", "right_joint")
    at = export(file, "urdf", replace(options, loads=(LoadPair(500.0, 700.0),)))[0]
    assert f'radius="{float(file.radius_m(500.0, 700.0)[1]):.9g}"' in at.data.decode()
    assert sum("follows the load" in note for note in at.notes) == 2


def test_the_model_is_never_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "m.urdf"
    model.write_bytes((MODELS / "differential.urdf").read_bytes())
    sample = Path(__file__).parents[2] / "sample_runs" / "corridor_crossed"
    arguments = ["export", str(sample), "--to", "urdf", "--into", str(model), "--left", "wheel_l", "--right", "wheel_r"]
    assert run([*arguments, "--output", str(tmp_path)]) == 2
    assert run([*arguments, "--output", str(tmp_path), "--force"]) == 2
    assert model.read_bytes() == (MODELS / "differential.urdf").read_bytes()
    assert run([*arguments, "--output", str(tmp_path / "out.urdf")]) == 0
    capsys.readouterr()


def test_wheels_on_the_wrong_side_are_noted(coefficients: CoefficientFile) -> None:
    model = MODELS / "differential.urdf"
    swapped = _export(coefficients, "urdf", model, "right_joint", "left_joint")
    assert any("look swapped" in note for note in swapped.notes)
    right = _export(coefficients, "urdf", model, "left_joint", "right_joint")
    assert not any("look swapped" in note for note in right.notes)
