"""Fixed sentences of ``words.toml``: paragraphs, captions, and what to do after a command."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from calib.campaign.check import CheckReport
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry
    from calib.radius.result import Fit


@cache
def catalogue() -> dict[str, dict[str, str]]:
    """Return the sentences of ``words.toml`` with places to fill in, by section and name."""
    text = Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
    sentences: dict[str, dict[str, str]] = tomllib.loads(text)
    return sentences


def paragraph(name: str, /, **values: object) -> str:
    """Return a paragraph of the report with its places filled in; see `catalogue`."""
    return catalogue()["report"][name].format(**values)


def caption(name: str, /, **values: object) -> str:
    """Return the caption of a picture, or of ``table-NAME``, with its places filled in; see `catalogue`."""
    return catalogue()["caption"][name].format(**values)


#: failed checks of a fit that further runs alone mend
_OF_MISSING_RUNS: Final = frozenset({"design", "order"})


def _quoted(word: str) -> str:
    plain = shlex.quote(word) == word or set(word) & set('"$`\\!')
    return shlex.quote(word) if plain else f'"{word}"'


def next_step(step: str, **names: str | Path | Iterable[str | Path]) -> str:
    """Return the line after a step of ``words.toml``; ``runs`` is the campaign `c`, where that has runs to diagnose."""
    campaign = Path(str(names.get("c", "")))
    names["runs"] = campaign if (campaign / "campaign.toml").is_file() else "CAMPAIGN"
    words = {name: [one] if isinstance(one, str | Path) else one for name, one in names.items()}
    quoted = {name: " ".join(map(_quoted, map(str, several))) for name, several in words.items()}
    return "Next: " + catalogue()["next"][step].format(**quoted)


#: what a check found -> its step, where the law of the load lacks runs
_NEEDED: Final = ("missing_counts", "missing_distance")
_LACKING: Final = {"few_runs": "check lacks runs", "one_session": "check lacks days"}


def after_check(report: CheckReport, columns: Iterable[str]) -> str:
    """Return the step that a check was; `columns`: of run table and logs."""
    used = report.found.n_runs - report.found.n_excluded
    nothing = (one.code in _NEEDED and one.text.startswith(f"{used} run(s)") for one in report.suspicious)
    if report.verdict == "wrong" or any(nothing):
        return "check wrong"
    front_alone = "counts_front" in columns and report.found.counts_left is None
    if report.found.distance_m is None or front_alone:
        return "check without distances"
    if {"ref_x_m", "ref_theta_rad", "gyro_z_radps", "loop"}.intersection(columns):
        return "check"
    codes = {note.code for note in report.suspicious}
    return next((step for code, step in _LACKING.items() if code in codes), "check lengths")


def after_fit(fit: Fit) -> str:
    """Return the step that a fit was: runs are missing only where nothing else fails."""
    failed = {check.name for wheel in fit.wheels.values() for check in wheel.checks if not check.passed}
    return "fit" if not failed else "fit lacks runs" if failed <= _OF_MISSING_RUNS else "fit failed"


def after_geometry(geometry: Geometry, output: Path | None) -> str:
    """Return the step that a geometry was; `output`: the coefficient file that was written."""
    if any("straight runs alone" in one for one in geometry.why):
        return "geometry lengths"
    return "geometry failed" if not geometry.passed else "geometry" if output is None else "geometry --output"


def after_diagnosis(diagnosis: Diagnosis, *, simulator: bool = False) -> str:
    """Return the step that a diagnosis was, by its verdict and fix; `simulator`: whether it was of the user's own."""
    kind = "recommended" if diagnosis.recommended else diagnosis.kind.value
    if simulator and diagnosis.recommended:
        tied = any(name.startswith("simulator:") for group in diagnosis.groups for name in group.effects)
        kind = "simulator" if diagnosis.fix.parameters else "simulator group" if tied else "simulator lacks"
    # what was corrected before the search has no finite signal
    wrong = diagnosis.correct_first or any(cause.signal == float("inf") for cause in diagnosis.causes)
    kind = diagnosis.kind.value if diagnosis.kind.value == "no_gap" else "wrong" if wrong else kind
    step = f"diagnose {kind}"
    if step in catalogue()["next"]:
        return step
    # runs to drive next are sought for confounded causes alone
    return without_runs(diagnosis) if diagnosis.groups and not (diagnosis.next_runs or simulator) else "diagnose"


def without_runs(diagnosis: Diagnosis) -> str:
    """Return the step where no run tells the causes apart: of two instruments a third length tells which is wrong."""
    from calib.gap.effects.reference import RangefinderScale, ReferenceScale

    instruments = {RangefinderScale.id, ReferenceScale.id}
    both = any(instruments.issubset(group.effects) for group in diagnosis.groups)
    return "plan instruments" if both else "plan nothing"
