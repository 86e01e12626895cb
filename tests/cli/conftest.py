"""Fixtures of the commands' tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry


@pytest.fixture(scope="module", autouse=True)
def computed_once(diagnosing: Callable[..., Diagnosis], estimating: Callable[..., Geometry]) -> Iterator[None]:
    """Let all commands share diagnoses and geometries: how these are made is the tests' of `gap` and `kinematics`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.gap.diagnose.diagnose_in_full", diagnosing)
        patch.setattr("calib.kinematics.estimate.estimate_geometry", estimating)
        yield


@pytest.fixture
def drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set each figure as SVG, and give its other files their format's name: the formats are the figures' own tests'."""
    from calib.reporting.figures import render

    monkeypatch.setattr(
        "calib.reporting.figures.render_all",
        lambda figure, forms: {form: render(figure, form) if form == "svg" else form.encode() for form in forms},
    )


@pytest.fixture
def files_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Build each figure, and give all its files their format's name: another test has the same figures drawn."""
    monkeypatch.setattr("calib.reporting.figures.render_all", lambda _, forms: {form: form.encode() for form in forms})
