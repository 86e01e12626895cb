"""Fixtures of the commands' tests."""

from __future__ import annotations

import pytest


@pytest.fixture
def drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set each figure as SVG, and give its other files their format's name: the formats are the figures' own tests'."""
    from calib.reporting.figures.style import render

    monkeypatch.setattr(
        "calib.reporting.figures.style.render_all",
        lambda figure, forms: {form: render(figure, form) if form == "svg" else form.encode() for form in forms},
    )
