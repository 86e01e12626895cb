"""A real robot with several small imperfections and a rest: what is named, how surely, and whether the fix holds.

Squares, circles, lines and turns on the spot under motion capture. An independent robust least squares over all end
poses gives radii unequal by -0.15 % and a track wider by 0.8 %, 1 % and more by turns on the spot.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.diagnose import diagnose_in_full
from calib.gap.inference.fit import fit, hypothesis_path
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import Path as DrivenPath
from calib.gap.predict import predict, residuals
from tests.real.recordings import available, optiodom_differential

#: held out: a recording of squares, of lines and turns on the spot, of circles
LEFT_OUT = ("230620202317", "250620201738", "250620202236")
#: standard errors by which an end-pose error may be larger and still be no worse
SCATTER = 2.0


@pytest.fixture(scope="module")
def diagnosed(shared_data: Path) -> Diagnosis:
    return diagnose_in_full(optiodom_differential(shared_data), plan=False)


def test_track_comes_first_and_unequal_radii_are_named_each_surely(diagnosed: Diagnosis) -> None:
    """A small rest beside them takes nothing of their probability."""
    causes = {cause.effect: cause for cause in diagnosed.causes}
    assert diagnosed.causes[0].effect == "track_width"
    assert causes["track_width"].probability > 0.9
    assert causes["track_width"].share > 0.5
    assert causes["unequal_radii"].probability > 0.9
    low, high = causes["unequal_radii"].parameters["relative"].ci95
    assert low < -0.0015 < high < 0.0
    assert diagnosed.unexplained is not None
    assert diagnosed.recommended


def test_without_labels_the_same_causes_are_named_and_the_fix_is_recommended(
    diagnosed: Diagnosis, shared_data: Path
) -> None:
    campaign = optiodom_differential(shared_data)
    bare = replace(campaign, runs=replace(campaign.runs, labels={"run_id": campaign.runs.labels["run_id"]}))
    verdict = diagnose_in_full(bare, plan=False)
    assert {cause.effect for cause in verdict.causes} == {cause.effect for cause in diagnosed.causes}
    assert verdict.causes[0].effect == "track_width"
    assert verdict.recommended


@pytest.fixture(scope="module")
def without(shared_data: Path) -> Diagnosis:
    """Of all recordings but those of `LEFT_OUT`."""
    names = {path.parent.name for path in available(shared_data, "optiodom/diff").glob("*/*/*_run-*.csv")}
    return diagnose_in_full(optiodom_differential(shared_data, sorted(names.difference(LEFT_OUT))), plan=False)


@pytest.mark.slow
@pytest.mark.parametrize("recording", LEFT_OUT)
def test_named_causes_predict_a_recording_left_out_no_worse_than_a_joint_calibration(
    recording: str, without: Diagnosis, shared_data: Path
) -> None:
    """End positions of the recording: nominal model, radii and track calibrated together, named causes added."""
    every = observations_of(optiodom_differential(shared_data))
    nominal, mine = predict(every), every.labels["session"] == recording

    def squares_m2(path: DrivenPath) -> np.ndarray:
        return np.sum(residuals(path, nominal)[mine, 1:3] ** 2, axis=1)

    effects = {effect.id: effect for effect in without.arrays.effects.values()}
    forms = [
        next(form for form in effects[own.effect].forms(every) if form.label == own.label).centred_at(own.centre)
        for own in without.fitted.forms
    ]
    joint = fit(without.nominal, without.noise).calibration
    by_joint = squares_m2(hypothesis_path(every, joint, [], [], nominal))
    by_causes = squares_m2(hypothesis_path(every, without.fitted.calibration, forms, without.fitted.theta, nominal))
    assert by_joint.mean() < squares_m2(nominal).mean()
    growth = by_causes - by_joint
    assert growth.mean() < SCATTER * growth.std(ddof=1) / np.sqrt(len(growth))
