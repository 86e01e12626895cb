"""Every command that writes, killed before each change of a name: each output is old or new, and the rerun succeeds."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib.campaign.model import Campaign
from calib.gap.decision.diagnosis import Diagnosis
from tests.robust.kill import JOBS, before_each_change, prepared, trial_of
from tests.robust.killing import ROOT

#: what takes long to compute and is no matter here, no matter what it gives
STAND_INS = {
    "calib.reporting.pages.to_pdf": b"%PDF-1.7",
    "calib.reporting.pages.to_html": "<html></html>",
    "calib.reporting.figures.render": b"<svg/>",
}


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return prepared(tmp_path_factory.mktemp("kills") / "base")


@pytest.mark.parametrize("name", ["export file", "ingest", "report", "fleet"])
def test_killed_before_any_change_of_a_name_every_output_is_old_or_new(
    name: str, base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole; inputs as before; ``check`` silent; the rerun gives the same, and leaves nothing behind."""
    for place, value in STAND_INS.items():
        monkeypatch.setattr(place, lambda *_args, _value=value, **_kwargs: _value)
    job = next(job for job in JOBS if job.name == name)
    if name == "report":
        # the page differs from one generation to the next by its date alone, which the stand-in lacks
        job = dataclasses.replace(job, earlier="")
    with trial_of(job, base) as trial:
        faults = list(before_each_change(trial))
    assert len(faults) > 1, "no change of a name was met"
    assert not any(faults), faults


def test_a_diagnosis_killed_before_any_change_of_a_name_leaves_model_and_result_whole(
    base: Path, diagnosed_sample: Callable[[str], tuple[Campaign, Diagnosis]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """``--apply`` and ``--into``, over files of an earlier generation."""
    diagnosis = diagnosed_sample("corridor_crossed")[1]
    monkeypatch.setattr("calib.gap.diagnose.diagnose_in_full", lambda *_args, **_kwargs: diagnosis)
    shutil.copytree(ROOT / "sample_runs" / "corridor_crossed", base / "crossed")
    job = next(job for job in JOBS if job.name == "diagnose")
    words: dict[str, Any] = {"arguments": job.arguments.replace("yard", "crossed")}
    with trial_of(dataclasses.replace(job, earlier="", **words), base) as trial:
        (trial.kept / "c.json").write_bytes(b"old")
        (trial.kept / "out" / "diagnosis.json").write_bytes(b"old")
        trial.put_back()
        trial.old = trial.state()
        faults = list(before_each_change(trial))
    assert len(faults) > 1, "no change of a name was met"
    assert not any(faults), faults
