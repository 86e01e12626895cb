"""The result at a glance."""

from __future__ import annotations

from calib.report.blocks import Column, Notice, Section, Table, Text
from calib.report.law_text import law_columns, law_row
from calib.report.numbers import prose, two_digits
from calib.report.source import Source

__all__ = ["section"]


def section(source: Source) -> Section:
    """Return the laws in one table and the verdict of the checks in one sentence."""
    fit = source.fit
    wheels = fit.wheels.items()
    low, high = _loads(source)
    reference = fit.left.law.reference_load_N
    zero = (
        f"F₀ = {reference:.4g} N"
        if reference == fit.right.law.reference_load_N
        else f"F₀ = {reference:.4g} N (left), {fit.right.law.reference_load_N:.4g} N (right)"
    )
    table = Table(
        f"Radius law of each wheel, r(F) = r(F₀) + s (F − F₀) with {zero}; expanded uncertainties U = k u for a "
        "coverage of 95 %, k from Student's t.",
        (Column("Wheel", align="left"), *law_columns()),
        tuple((name, *law_row(wheel)) for name, wheel in wheels),
    )
    failed = [
        f"{name} wheel, {check.name.replace('_', ' ')}" for name, wheel in wheels for check in wheel.checks
        if not check.passed
    ]  # fmt: skip
    remarks = [check for _, wheel in wheels for check in wheel.checks if check.level == "note"]
    if failed:
        notice = Notice(
            "bad",
            "The law should not be used as it is",
            f"Failed: {'; '.join(failed)}. The section on residual checks says what that means and what to do.",
        )
    elif remarks:
        said = tuple(dict.fromkeys(prose(check.sentence) for check in remarks))
        notice = Notice("note", "The law can be used; its user has to know this", " ".join(said[:3]))
    else:
        notice = Notice("good", "The law can be used", "Every check of the fit passed without remark.")
    texts = [
        Text(
            f"The law holds for {_of_loads(low, high)}. It comes from {len(fit.radii)} runs along "
            f"a straight corridor. The same law, with its covariance, is attached to this PDF as coefficients.json."
        )
    ]
    sentence = _wide_single_run(source)
    if sentence:
        texts.append(Text(sentence))
    return Section("Result", (table, *texts, notice))


def _loads(source: Source) -> tuple[float, float]:
    laws = [wheel.law for wheel in source.fit.wheels.values()]
    return max(law.load_min_N for law in laws), min(law.load_max_N for law in laws)


def _of_loads(low: float, high: float) -> str:
    if high - low < 1.0:
        return f"a wheel load of {low:.0f} N"
    return f"wheel loads from {low:.0f} to {high:.0f} N"


def _wide_single_run(source: Source) -> str:
    """Say how far one further run may lie off: the law's own interval does not answer that."""
    parts = []
    for name, wheel in source.fit.wheels.items():
        middle = 0.5 * (wheel.law.load_min_N + wheel.law.load_max_N)
        low, high = wheel.prediction_band_m(middle)
        parts.append(f"{two_digits(0.5e6 * float(high - low))} µm ({name})")
    return (
        "The radius that one further run shows lies, with 95 % probability, within "
        + " and ".join(f"±{part}" for part in parts)
        + " of the law in the middle of the load range."
    )
