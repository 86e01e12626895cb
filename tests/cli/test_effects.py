"""``calib effects``: the library, and the effects that users add, each with where it comes from."""

from __future__ import annotations

import json
import shutil
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from calib.cli.main import run
from calib.gap.effects import quantities
from calib.gap.effects.library import REGISTRY
from calib.reporting.topics.runs import size_text

DECLARED = """
[[effects]]
id = "tyre"
column = "temperature_C"
acts_on = "both"
typical = 1e-4
largest = 1e-3
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """A sample with an effect of the user's own."""
    folder = tmp_path_factory.mktemp("effects") / "c"
    shutil.copytree(project_root / "sample_runs" / "corridor_crossed", folder)
    with (folder / "campaign.toml").open("a", encoding="utf-8") as file:
        file.write(DECLARED)
    return folder


def test_every_effect_of_the_library_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    """All ids stand in the table, which keeps to 80 columns, and the demonstration's runs show all but five."""
    assert run(["effects"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines if line} >= set(REGISTRY)
    assert max(map(len, lines)) <= 80
    assert run(["effects", "--json", "-"]) == 0
    listed = json.loads(capsys.readouterr().out)["effects"]
    silent = {entry["id"] for entry in listed if not entry["shows"]}
    # found by trial; need measured weaves, an outside simulator's poses, a gyro, or two driven wheels
    assert silent == {"encoder_gross", "path_weave", "integration_scheme", "gyro_scale", "wheel_slip"}


def test_the_signature_is_the_effects_arithmetic(capsys: pytest.CaptureFixture[str]) -> None:
    """A track wider by a share turns a square by that share less: 1 % of 2 pi, to first order exactly."""
    assert run(["effects", "track_width", "--json", "-"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["effects"]
    assert entry["parameters"][0]["typical"] == 0.01
    assert entry["signature"]["square_cw"]["heading"] == pytest.approx(0.01 * 2 * 3.141592653589793, rel=1e-6)
    assert entry["signature"]["corridor"]["heading"] == pytest.approx(0.0, abs=1e-9)


def test_what_a_campaign_declares_is_listed_with_its_origin(campaign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["effects", "--campaign", str(campaign)]) == 0
    assert "- tyre: from [[effects]] of campaign.toml" in capsys.readouterr().out
    assert run(["effects", "tyre", "--campaign", str(campaign)]) == 0
    assert "± 100 ppm per temperature_C" in capsys.readouterr().out


def test_an_effect_of_a_package_is_listed_with_the_package(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    point = EntryPoint("ours", "tests.gap.effects.test_columns:Foreign", quantities.ENTRY_POINT_GROUP)
    monkeypatch.setattr(quantities, "entry_points", lambda group: [point])
    assert run(["effects"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert "- foreign: from an installed package (ours = tests.gap.effects.test_columns:Foreign)" in words


def test_an_unknown_effect_is_one_line_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["effects", "trackwidth"]) == 2
    assert "did you mean 'track_width'?" in capsys.readouterr().err


def test_a_signature_is_drawn_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three forms of one picture; an existing one is refused."""
    # how a figure becomes bytes has its own tests
    monkeypatch.setattr(
        "calib.reporting.figures.render_all", lambda _figure, forms: {form: form.encode() for form in forms}
    )
    assert run(["effects", "curve_scrub", "--figures", str(tmp_path)]) == 0
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [f"signature-curve_scrub.{form}" for form in ("pdf", "png", "svg")]
    assert run(["effects", "curve_scrub", "--figures", str(tmp_path)]) == 2
    assert "existing file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1e-6, "m/N", "1 µm/N"),
        (3e-3, "1", "0.3 %"),
        (5e-5, "1/K", "50 ppm/K"),
        (0.015, "m", "15 mm"),
        (0.05, "s", "0.05 s"),
        (1e-4, "1 per bar", "100 ppm per bar"),
    ],
)
def test_sizes_are_written_as_people_read_them(value: float, unit: str, text: str) -> None:
    assert size_text(value, unit) == text
