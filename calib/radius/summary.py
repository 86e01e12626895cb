"""What a fit says in a few lines of text, for the interpreter, and in a small table, for notebooks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape

from calib.radius.regression import WheelFit

__all__ = ["repr_html", "summary_lines"]


def summary_lines(
    name: str, wheels: Mapping[str, WheelFit], *, simulated: bool, checks: bool = True, notes: Sequence[str] = ()
) -> Iterator[str]:
    """Yield the lines of a summary.

    Parameters
    ----------
    name : str
        Name of the campaign.
    wheels : mapping of str to WheelFit
        The wheels in the order shown.
    simulated : bool
        Whether a program made the data, which the first line says.
    checks : bool
        Add scatter, degrees of freedom and what the checks found.
    notes : sequence of str
        Sentences put at the end.
    """
    passed = all(check.passed for wheel in wheels.values() for check in wheel.checks)
    verdict = "every check allows its use" if passed else "a check says not to use it"
    yield f"Radius law of {name or 'a campaign'}{' (simulated)' if simulated else ''}: {verdict}"
    for wheel, fit in wheels.items():
        radius, slope = _values(fit)
        yield f"  {wheel:<5}  radius at {fit.law.reference_load_N:.0f} N  {radius}"
        if slope:
            yield f"         change with load    {slope}"
        if checks:
            law = fit.law
            yield f"         {law.n_runs} runs, {law.load_min_N:.0f} to {law.load_max_N:.0f} N, {fit.design} design"
            yield f"         a single run scatters by {1e6 * law.residual_std_m:.2f} um; R^2 {fit.r_squared:.4f}"
            for check in fit.checks:
                if check.level != "ok":
                    yield f"         {check.name}: {check.sentence}"
    yield "  +- is half the 95 % interval"
    for note in notes:
        yield f"  note: {note}"


def repr_html(name: str, wheels: Mapping[str, WheelFit], *, simulated: bool) -> str:
    """Return the laws as an HTML table: a row a wheel."""
    rows = []
    for wheel, fit in wheels.items():
        radius, slope = _values(fit)
        cells = (wheel, f"{fit.law.reference_load_N:.0f} N", radius, slope or "constant", str(fit.law.n_runs))
        rows.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
    title = f"Radius law of {escape(name or 'a campaign')}{' (simulated)' if simulated else ''}"
    head = "".join(f"<th>{cell}</th>" for cell in ("wheel", "at load", "radius", "change with load", "runs"))
    caption = f"<caption>{title}; &plusmn; is half the 95&nbsp;% interval</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _values(fit: WheelFit) -> tuple[str, str]:
    """Return radius and slope, each with half its 95 % interval; the slope empty for a constant."""
    low, high = fit.radius_ref_ci95_m
    radius = f"{1e3 * fit.law.radius_ref_m:.4f} +- {500 * (high - low):.4f} mm"
    if fit.slope_ci95_m_per_N is None:
        return radius, ""
    low, high = fit.slope_ci95_m_per_N
    return radius, f"{1e9 * fit.law.slope_m_per_N:.2f} +- {5e8 * (high - low):.2f} nm/N"
