"""The result at a glance."""

from __future__ import annotations

from calib.report.blocks import Notice, Section, Text
from calib.report.numbers import prose
from calib.report.source import Source
from calib.report.statements.assumed import assumed_notice
from calib.report.statements.checks import usable_notice
from calib.report.statements.diagnosis import TITLES, verdict_notice
from calib.report.statements.law import law_table, single_run_text


def section(source: Source) -> Section:
    """Return the laws in one table and the verdict of the checks in one sentence."""
    fit = source.fit
    laws = [wheel.law for wheel in fit.wheels.values()]
    low, high = max(law.load_min_N for law in laws), min(law.load_max_N for law in laws)
    loads = f"a wheel load of {low:.0f} N" if high - low < 1.0 else f"wheel loads from {low:.0f} to {high:.0f} N"
    holds = Text(
        f"The law holds for {loads}. It comes from {len(fit.radii)} runs along a straight corridor. The same law, with "
        "its covariance, is attached to this PDF as coefficients.json."
    )
    assumed = () if fit.setup is None else assumed_notice(fit.setup.assumed)
    return Section("Result", (law_table(fit), holds, single_run_text(fit), usable_notice(fit), *assumed, *_gap(source)))


def _gap(source: Source) -> tuple[Notice, ...]:
    """Return what a diagnosis found, where one was made with this report or lies beside the fit."""
    if source.gap is not None:
        return (verdict_notice(source.gap.verdict),)
    if source.known_verdict is None:
        return ()
    kind, sentence = source.known_verdict
    level, title = TITLES[kind]
    return (Notice(level, f"{title} ({kind.value}, from diagnosis.json)", prose(sentence)),)
