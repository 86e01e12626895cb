"""The documentation site builds without a warning and without the network, and says all there is to say."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from calib.campaign import settings
from calib.campaign.model import LABEL_COLUMNS, LOG_COLUMNS, NUMERIC_COLUMNS
from calib.cli import COMMANDS
from calib.gap.effects.library import REGISTRY

ROOT = Path(__file__).resolve().parents[2]
FORMAT = (ROOT / "docs" / "format.md").read_text(encoding="utf-8")
WORDS = set(re.findall(r"\w+", FORMAT))


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    """`mkdocs build --strict` fails on any warning; no proxy answers, so that a fetch would fail."""
    pytest.importorskip("mkdocs", reason="the extra docs is not installed")
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"), "http://127.0.0.1:9")
    environment = {**os.environ, **nowhere, "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    assert (tmp_path / "site" / "start.html").is_file()
    commands = (tmp_path / "site" / "commands.html").read_text(encoding="utf-8")
    assert {name for name in COMMANDS if f"Usage: calib {name} [OPTIONS]" not in commands} == set()


@pytest.mark.parametrize("name", [*LABEL_COLUMNS, *NUMERIC_COLUMNS, *LOG_COLUMNS])
def test_every_column_is_in_the_format(name: str) -> None:
    assert name in WORDS


@pytest.mark.parametrize("kind", [settings.Encoder, settings.OdometryModel, settings.Rangefinder, settings.Reference])
def test_every_setting_is_in_the_format(kind: type) -> None:
    """Each field of a section of campaign.toml is named on the page."""
    missing = [name for name in kind.__dataclass_fields__ if name not in WORDS]
    assert not missing


@pytest.mark.parametrize("name", REGISTRY)
def test_every_effect_has_its_page(name: str) -> None:
    assert (ROOT / "docs" / "effects" / f"{name}.md").is_file()


def test_the_atlas_is_up_to_date() -> None:
    """The pages say what the effects say of themselves."""
    done = subprocess.run(
        [sys.executable, "docs/atlas.py", "--check"], cwd=ROOT, env={**os.environ, "PYTHONPATH": "."}, check=False
    )
    assert done.returncode == 0
