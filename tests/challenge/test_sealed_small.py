"""A small sealed set, made, diagnosed and scored from end to end; it guards the score."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import pytest

from calib.challenge import make, read_public, run
from calib.challenge.score import Score, score
from calib.errors import BadFileError, BadInputError, inputs_kept, refuse_input
from calib.gap.diagnose import diagnose_in_full


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory) -> Score:
    """The cases of the small plan, made, diagnosed and scored."""
    folder = tmp_path_factory.mktemp("blind") / "set"
    make(Path(__file__).parent / "seeds" / "ci.toml", folder, workers=1)
    with pytest.MonkeyPatch.context() as patch:
        # a plan of further runs enters no score
        patch.setattr("calib.gap.diagnose.diagnose_in_full", partial(diagnose_in_full, plan=False))
        run(folder, workers=1)
    return score(folder)


def test_no_case_ends_in_an_error(scored: Score) -> None:
    assert [case.error for case in scored.cases if case.verdict in ("error", "missing")] == []


def test_a_set_whose_list_of_cases_has_no_end_is_refused(tmp_path: Path) -> None:
    """A pipe would be waited for."""
    os.mkfifo(tmp_path / "challenge.json")
    with pytest.raises(BadFileError, match="no regular file"):
        read_public(tmp_path)


def test_the_list_of_cases_is_an_input(tmp_path: Path) -> None:
    """Other JSON in a folder is a result, which may be replaced."""
    (tmp_path / "challenge.json").write_text("{}")
    (tmp_path / "score.json").write_text("{}")
    with inputs_kept([tmp_path]):
        refuse_input(tmp_path / "score.json")
        with pytest.raises(BadInputError, match="found an input of this command"):
            refuse_input(tmp_path / "challenge.json")


def test_empty_campaigns_raise_no_alarm(scored: Score) -> None:
    """At a rate of 5 % two alarms or more in three have a chance of 0.7 %."""
    assert scored.board["false alarms"].hits <= 1


def test_strong_effects_that_can_be_told_apart_are_named_first(scored: Score) -> None:
    """At a rate of 95 % two misses or more in four have a chance of 1.4 %."""
    strong = scored.board["first at signal >= 10, where no other effect is nearer than 3 sigma"]
    assert strong.total >= 3
    assert strong.total - strong.hits <= 1


def test_strong_effects_are_named_or_stand_in_the_named_group(scored: Score) -> None:
    """At a rate of 99 % two misses or more in four have a chance of 0.06 %."""
    strong = scored.board["first or its group at signal >= 10"]
    assert strong.total - strong.hits <= 1


def test_a_mis_set_calibration_is_named_as_such(scored: Score) -> None:
    assert scored.board["calibration named first"].hits == scored.board["calibration named first"].total


def test_few_fixes_are_wrong(scored: Score) -> None:
    """At a rate of 2 % two or more in twelve have a chance of 2.3 %."""
    assert scored.board["wrong fixes"].hits <= 1
