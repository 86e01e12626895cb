"""What labels and end poses are not needed for: the same campaign without them ends as with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from calib.campaign.model import Campaign
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.diagnose import diagnose_in_full
from calib.radius.fit import fit_campaign

Diagnosed = Callable[[str], tuple[Campaign, Diagnosis]]
POSES = ("ref_x_m", "ref_y_m", "ref_theta_rad")


def without(campaign: Campaign, *, labels: Sequence[str] = (), columns: Sequence[str] = ()) -> Campaign:
    """The campaign as if nobody had written these labels, or measured these columns."""
    runs, logs = campaign.runs, campaign.logs
    return replace(
        campaign,
        runs=replace(
            runs,
            labels={name: column for name, column in runs.labels.items() if name not in labels},
            numbers={name: column for name, column in runs.numbers.items() if name not in columns},
        ),
        logs=replace(logs, columns={name: column for name, column in logs.columns.items() if name not in columns}),
    )


def outcome(verdict: Diagnosis) -> tuple[str, list[str]]:
    return verdict.kind.value, [cause.effect for cause in verdict.causes]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["corridor", "yard"])
def test_a_verdict_does_not_hang_on_labels(name: str, diagnosed_sample: Diagnosed) -> None:
    """Without kinds and sessions a sample ends as with them; stretches under one load represent sessions."""
    campaign, diagnosis = diagnosed_sample(name)
    bare = without(campaign, labels=("kind", "session"))
    assert outcome(diagnose_in_full(bare, plan=False)) == outcome(diagnosis)


@pytest.mark.slow
def test_a_corridor_without_end_poses_still_has_two_wheels(diagnosed_sample: Diagnosed) -> None:
    """Distance and counts alone end as with poses, with slopes inside the fit's intervals, wheel by wheel."""
    campaign, diagnosis = diagnosed_sample("corridor_crossed")
    verdict = diagnose_in_full(without(campaign, columns=POSES), plan=False)
    assert outcome(verdict) == outcome(diagnosis)
    wheels = fit_campaign(campaign).to_dict()["wheels"]
    for side, wheel in wheels.items():
        low, high = wheel["slope_ci95_m_per_N"]
        assert low < verdict.causes[0].parameters[f"slope_{side}"].value < high
