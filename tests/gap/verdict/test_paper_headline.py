"""The paper's headline stands beside a campaign's own where the load is the cause, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.gap.verdict.outcome import Closure, Fix, Group
from calib.gap.verdict.paper_headline import headline
from calib.gap.verdict.result import Cause, Verdict, VerdictKind


def _verdict(effect: str, *, group: tuple[str, ...] = (), before: float | None = 2.2, after: float = 0.1) -> Verdict:
    cause = Cause(effect, "", "", probability=0.9, share=1.0, signal=30.0, parameters={})
    return Verdict(
        kind=VerdictKind.AMBIGUOUS if group else VerdictKind.EXPLAINED,
        sentence="",
        causes=(cause,),
        groups=(Group(group),) if group else (),
        closure=Closure() if before is None else Closure(before_rms_m=before, after_rms_m=after),
        fix=Fix(recommended=True),
    )


@pytest.mark.parametrize("effect", ["load_radius", "load_radius_nonlinear"])
def test_a_load_effect_has_the_papers_figures_beside_it(effect: str) -> None:
    """1.1 m to 0.06 m are those of the paper's Section 7; 2.2 m to 0.1 m is 22 times."""
    found = headline(_verdict(effect))
    assert found is not None
    assert (found.paper.before_m, found.paper.after_m) == (1.1, 0.06)
    # the paper's study at its track gives 1.24753 m and 0.07375 m; the quotient of what it prints, 18, is rounded
    assert found.paper.ratio == pytest.approx(1.24753 / 0.07375, rel=1e-4)
    assert "about 17 times smaller before rounding" in found.sentence
    assert found.campaign.ratio == pytest.approx(22.0, rel=1e-12)  # a quotient of two doubles
    assert found.sole_candidate
    assert "1.1 m to 0.06 m as printed" in found.sentence and "2.20 m to 0.1 m" in found.sentence


def test_a_cause_that_cannot_be_told_from_others_says_so() -> None:
    found = headline(_verdict("load_radius", group=("load_radius", "session_step")))
    assert found is not None and not found.sole_candidate
    assert "if the load is the cause" in found.sentence


def test_other_causes_and_verdicts_without_closure_have_none() -> None:
    assert headline(_verdict("temperature_radius")) is None
    assert headline(_verdict("load_radius", before=None)) is None
    assert headline(replace(_verdict("load_radius"), causes=())) is None


def test_a_gap_that_vanishes_has_no_ratio() -> None:
    found = headline(_verdict("load_radius", after=0.0))
    assert found is not None and found.campaign.ratio is None
