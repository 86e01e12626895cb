"""Campaigns of many samples are worked through some observations at a time, which changes no answer."""

from __future__ import annotations

import errno
import mmap
import os
from dataclasses import replace

import numpy as np
import pytest

import calib.gap.observations as data
from calib.gap import Perturbation
from calib.gap.effects.library import library
from calib.gap.inference.fit import hypothesis_path, signature_columns
from calib.gap.inference.noise_components import kernels
from calib.gap.observations import Observations
from calib.gap.observations import observation as held_steps
from calib.gap.predict import Path, predict
from tests.gap.effects.making import rich_runs, situation

#: running sums over all observations and over some round differently
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def whole() -> Observations:
    s = situation(rich_runs())
    # settled while as many steps are worked on at once as ever
    assert len(s.spans) == 1
    return s


@pytest.fixture(params=["kept", "made anew", "in files"])
def parted(request: pytest.FixtureRequest, whole: Observations, monkeypatch: pytest.MonkeyPatch) -> Observations:
    """The same, about three observations at a time, parts kept or too many for it; or steps too many for memory."""
    monkeypatch.setattr(data, "STEPS_AT_ONCE", 3 * int(whole.lengths.max()))
    if request.param == "kept":
        return replace(whole)
    monkeypatch.setattr(data, "KEPT_STEPS", 0)
    if request.param == "made anew":
        return replace(whole)
    monkeypatch.setattr(held_steps, "HELD_STEPS", 0)
    steps = {}
    for name in data._OF_STEPS:
        values = getattr(whole, name)
        if values is not None:
            steps[name] = held_steps.step_array(len(values))
            steps[name][:] = values
            assert isinstance(steps[name].base, mmap.mmap)
            held_steps.let_go(steps[name])
    return replace(whole, **steps)


def bent(s: Observations) -> Path:
    """A path under perturbations by observation and by step."""
    by_unit, by_step = np.linspace(-1e-3, 1e-3, len(s)), 1e-4 * np.abs(s.path_m)
    return predict(s, [Perturbation(left=by_unit, track=by_unit), Perturbation(heading_rad=by_step, lateral_m=by_step)])


def test_parts_cover_every_unit_once_and_hold_no_more_steps_than_are_worked_on_at_once(parted: Observations) -> None:
    spans = parted.spans
    assert len(spans) > 2
    np.testing.assert_array_equal(
        np.concatenate([np.arange(len(parted))[units] for units in spans]), range(len(parted))
    )
    assert all(len(parted.part(units).unit) <= data.STEPS_AT_ONCE for units in spans)


def test_a_part_knows_its_place_in_the_whole(parted: Observations) -> None:
    marks = np.arange(len(parted))
    for units in parted.spans:
        np.testing.assert_array_equal(parted.part(units).here(marks), marks[units])


def test_a_path_in_parts_is_the_path(whole: Observations, parted: Observations) -> None:
    """Ends, readings, their derivatives and the shapes of the noise; steps are worked out anew where asked for."""
    expected, path = bent(whole), bent(parted)
    assert path.kept is None
    for name in ("end", "reading", "line_m", "calibration", "way_m", "rolling_radii_m"):
        np.testing.assert_allclose(getattr(path, name), getattr(expected, name), rtol=ROUNDING, atol=ROUNDING)
    for name in ("mid_rad", "x_m", "ds_m"):
        found, of_steps = getattr(path.steps, name), getattr(expected.steps, name)
        np.testing.assert_allclose(found, of_steps, rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(kernels(path), kernels(expected), rtol=ROUNDING, atol=ROUNDING)


def test_every_form_shows_in_parts_what_it_shows_on_the_whole(whole: Observations, parted: Observations) -> None:
    forms, same = ([form for effect in library(s) for form in effect.forms(s)] for s in (whole, parted))
    about, path = bent(whole), bent(parted)
    for form, other, column, parts in zip(
        forms, same, signature_columns(about, forms), signature_columns(path, same), strict=True
    ):
        assert (form.effect, form.label) == (other.effect, other.label)
        scale = np.abs(column).max()
        np.testing.assert_allclose(parts, column, rtol=0, atol=ROUNDING * max(scale, 1.0), err_msg=form.label)


def test_a_hypothesis_in_parts_ends_where_it_ends_on_the_whole(whole: Observations, parted: Observations) -> None:
    calibration, ends = np.array([1e-3, -1e-3, 2e-3, 0.0]), []
    for s in (whole, parted):
        forms = [form for effect in library(s) for form in effect.forms(s) if form.by_parts]
        theta = [form.typical for form in forms]
        ends.append(hypothesis_path(s, calibration, forms, theta, predict(s)).end)
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=ROUNDING)


def test_steps_are_held_where_the_disk_has_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of it is asked for at once: a disk that fills up later would be the end of the process."""

    def full(file: int, first: int, size: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(held_steps, "HELD_STEPS", 0)
    in_file = held_steps.step_array(1000)
    monkeypatch.setattr(os, "posix_fallocate", full)
    held = held_steps.step_array(1000)
    assert isinstance(in_file.base, mmap.mmap)
    assert held.base is None
    for steps in (in_file, held):
        assert not steps.any()
        steps[:] = np.arange(1000.0)
        held_steps.let_go(steps)
        np.testing.assert_array_equal(steps, np.arange(1000.0))
