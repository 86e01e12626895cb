"""The sample whose effect is withheld."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np

from calib.campaign.read import read_campaign


def test_the_yard_is_what_its_script_makes(project_root: Path) -> None:
    """The committed campaign is the one that the committed script makes, to the last count."""
    import importlib.util

    spec = importlib.util.spec_from_file_location("make_yard", project_root / "sample_runs" / "make_yard.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    made, read = script.yard(), read_campaign(project_root / "sample_runs" / "yard")
    assert read.simulated
    for column in ("counts_left", "counts_right", "distance_m", "ref_x_m", "ref_theta_rad", "temperature_C"):
        # atol: the file has as many decimals as the table was rounded to
        np.testing.assert_allclose(read.runs.number(column), made.runs.number(column), atol=1e-9)


def test_the_yard_holds_corridor_square_and_paper_route_runs(project_root: Path) -> None:
    read = read_campaign(project_root / "sample_runs" / "yard")
    kinds = set(read.runs.label("kind"))
    assert {"corridor", "square_cw", "square_ccw", "route_left", "route_right"} <= kinds
    assert 60 <= len(read.runs) <= 80
    assert len(set(read.runs.label("session"))) >= 3
    assert sum(path.stat().st_size for path in (project_root / "sample_runs" / "yard").rglob("*")) < 3_000_000


def test_the_yard_does_not_give_its_effect_away(project_root: Path) -> None:
    sealed = json.loads((project_root / "sample_runs" / "truth" / "yard.json").read_text(encoding="utf-8"))["sealed"]
    effect = json.loads(base64.b64decode(sealed))["causes"][0]["effect"]
    for path in [
        project_root / "sample_runs" / "make_yard.py",
        project_root / "sample_runs" / "yard" / "campaign.toml",
        project_root / "sample_runs" / "yard" / "runs.csv",
    ]:
        assert effect not in path.read_text(encoding="utf-8")
