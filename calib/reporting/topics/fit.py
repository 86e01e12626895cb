"""Result of a fit: both laws with their budget, checks, runs, pictures, and comparison with a model."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from calib import reporting
from calib.campaign.checks import SIDES, WEIGHTY, listed
from calib.radius.regression import FAIL_BELOW, NOTE_BELOW, Check, WheelFit, t_quantile
from calib.radius.result import Difference, Fit, ModelComparison
from calib.reporting import Block, Notice, Picture, Section, Table, Text, caption, formatting, items, picture, table
from calib.reporting.formatting import MISSING, aligned, fixed, measured, places, plural, prose, span, two_digits
from calib.types import FloatArray, grouped

if TYPE_CHECKING:
    from calib.reporting.source import Source

#: in the order of the report's pages
FIT_PICTURES: Final = ("runs-by-series", "regressions", "path-deviation", "residuals", "budget")


def fit_content(fit: Fit, *, runs: bool = False) -> tuple[Block | Section, ...]:
    """Return what a fit says; with `runs` the radius of every run, too."""
    sessions = len(set(fit.radii.session.tolist()))
    return (
        reporting.Heading(f"{fit.name}: {plural(len(fit.radii), 'run')} in {plural(sessions, 'session')}"),
        *([reporting.simulated_notice()] if fit.simulated else []),
        law_table(fit),
        _single_run_text(fit),
        Text(" ".join(map(quality_text, fit.wheels.values()))),
        *([static_table(fit)] if fit.static else []),
        _checks_table(fit),
        *([radius_budget(fit)] if fit.radii.budget else []),
        *([runs_table(fit)] if runs else []),
        *items(map(prose, fit.notes)),
        *([left_out_table(fit)] if fit.radii.left_out else []),
        usable_notice(fit),
    )


def comparison_content(compared: ModelComparison, notes: Sequence[str]) -> tuple[Block, ...]:
    """Return a fitted law held against a model's."""
    kinds = {"radius_ref": (f"radius at {compared.reference_load_N:.0f} N", 1e3, "mm"), "slope": ("slope", 1e6, "µm/N")}
    rows = [_compared(one, *kinds[one.quantity]) for one in compared.differences]
    interval = ("95 % interval | from", "95 % interval | to")
    heads = ("<Quantity", "<Unit", "Fitted", "Model", "Difference", *interval, "<Model lies")
    exact = "; the model states no uncertainty, its values are taken as exact" if compared.exact else ""
    caption = f"Fitted law against the model's; the interval is that of the difference{exact}."
    return (table(caption, heads, rows), *items(map(prose, notes)))


def _compared(difference: Difference, name: str, factor: float, unit: str) -> tuple[str, ...]:
    low, high = (factor * end for end in difference.ci95)
    decimals = places(0.5 * (high - low))
    values = (factor * difference.fitted, factor * difference.model, factor * difference.difference, low, high)
    numbers = (fixed(value, decimals) for value in values)
    return (f"{difference.wheel}: {name}", unit, *numbers, "inside" if difference.inside else "OUTSIDE")


def result_section(source: "Source") -> Section:
    """Return the laws in a table, and the checks' verdict."""
    fit = source.fit
    laws = [wheel.law for wheel in fit.wheels.values()]
    ranges = [span(one.load_min_N, one.load_max_N, "N", ".0f") for one in laws]
    loads = ranges[0] if ranges[0] == ranges[1] else f"{ranges[0]} (left wheel) and {ranges[1]} (right wheel)"
    holds = Text(reporting.paragraph("law_holds", loads=loads, runs=len(fit.radii)))
    assumed = _assumed_notice(source.setup.assumed)
    return Section(
        "Result", (law_table(fit), holds, _single_run_text(fit), usable_notice(fit), *assumed, *_gap(source))
    )


def assumed_text(assumed: Mapping[str, str]) -> Text:
    """Return unstated keys of ``campaign.toml``, with the values assumed."""
    if not assumed:
        return Text("Every setting that these results depend on is stated by the campaign; none is assumed.")
    return Text(
        f"Assumed, not stated by the campaign: {_listed(assumed)}. Results that depend on these are not measured."
    )


def _assumed_notice(assumed: Mapping[str, str]) -> tuple[Notice, ...]:
    weighty = {key: value for key, value in assumed.items() if key in WEIGHTY}
    if not weighty:
        return ()
    text = f"{_listed(weighty)}. Every radius or path scales with these: state the vehicle's own in campaign.toml."
    return (Notice("note", "Assumed, since the campaign does not state it", text),)


def _listed(assumed: Mapping[str, str]) -> str:
    return ", ".join(f"{key} = {value}" if value else key for key, value in assumed.items())


def diagnosis_section(source: "Source") -> Section | None:
    """Return the findings of the diagnosis, if any."""
    if source.verdict is None:
        return None
    from calib.reporting.topics.diagnosis import gap_section

    return gap_section(source.verdict, source.gap)


def _gap(source: "Source") -> tuple[Notice, ...]:
    if source.verdict is None and source.known_verdict is None:
        return ()
    from calib.reporting.topics.diagnosis import TITLES, page_one_notice, with_kind

    if source.verdict is not None:
        return (page_one_notice(source.verdict),)
    assert source.known_verdict is not None
    kind, sentence = source.known_verdict
    level, title = TITLES[kind]
    return (Notice(level, with_kind(title, kind, "from diagnosis.json"), prose(sentence)),)


def fit_pictures(fit: Fit) -> tuple[Picture, ...]:
    """Return the pictures that a report on a fit shows."""
    draw = (runs_picture, regressions_picture, deviation_picture, residuals_picture)
    return (*(picture(fit) for picture in draw), *((budget_picture(fit),) if fit.radii.budget else ()))


def fit_brief(fit: Fit) -> tuple[Block, ...]:
    """Return what the interpreter shows of a fit."""
    return (law_table(fit), usable_notice(fit))


_LEVELS: Final = {"ok": "passed", "note": "remark", "failed": "FAILED"}
MAX_REMARKS: Final = 3


def _checks_table(fit: Fit) -> Table:
    listed = [(wheel, check) for wheel, fitted in fit.wheels.items() for check in fitted.checks]
    names = list(dict.fromkeys(check.name for _, check in listed))
    alike = grouped(((names.index(one.name), one.level, one.sentence), (wheel, one)) for wheel, one in listed)
    rows = []
    for number, level, sentence in sorted(alike, key=lambda key: key[0]):
        wheels, checks = zip(*dict(alike[number, level, sentence]).items(), strict=True)
        chances = " / ".join(dict.fromkeys(formatting.probability(check.p_value) for check in checks))
        whose = "both" if len(wheels) == 2 else wheels[0]
        cells = (names[number].replace("_", " "), whose, _LEVELS[level], _statistics(checks), chances, prose(sentence))
        rows.append(cells)
    heads = ("<Check", "<Wheel", "<Verdict", "*~Statistic", "~p", "*Meaning")
    return table(caption("table-checks"), heads, rows, dense=True)


def _statistics(checks: Sequence[Check]) -> str:
    known = [(one.statistic_name, one.statistic) for one in checks if one.statistic is not None and one.statistic_name]
    values = grouped((name, f"{value:.3g}".replace("-", "−")) for name, value in known)
    return prose("; ".join(f"{name} = {' / '.join(dict.fromkeys(each))}" for name, each in values.items()))


def usable_notice(fit: Fit) -> Notice:
    """Return whether the law can be used."""
    checks = [(name, check) for name, wheel in fit.wheels.items() for check in wheel.checks]
    if fit.implausible and fit.accepted:
        findings = f"Reason given: {prose(fit.accepted)}. Findings: {' '.join(map(prose, fit.implausible))}"
        return Notice("bad", "Implausible, and accepted by the user", findings)
    if fit.failed:
        title = "The law should not be used as it is" if fit.implausible else "The law is doubtful"
        return Notice("bad", title, f"FAILED: {'; '.join(fit.failed)}. The checks say what that means and what to do.")
    noted = [(prose(check.sentence), f"{name.capitalize()} wheel: ") for name, check in checks if check.level == "note"]
    if remarks := grouped(noted):
        texts = [text if len(wheels) > 1 else wheels[0] + text for text, wheels in remarks.items()]
        return Notice("note", "The law can be used; its user has to know this", " ".join(texts[:MAX_REMARKS]))
    return Notice("good", "The law can be used", "Every check of the fit passed without remark.")


def residuals_section(source: "Source") -> Section:
    """Return the residuals, and the checks of both wheels."""
    fit = source.fit
    return Section("Residual checks", (residuals_picture(fit), _checks_table(fit)))


def decision_section(source: "Source") -> Section:
    """Return the rule that judged the checks, and what was not judged."""
    tests = sum(check.p_value is not None for wheel in source.fit.wheels.values() for check in wheel.checks)
    false_alarm = 100 * (1 - (1 - NOTE_BELOW) ** tests)
    values = {"note": NOTE_BELOW, "fail": FAIL_BELOW, "false_alarm": false_alarm, "failures": 100 * tests * FAIL_BELOW}
    rules = ("remark", "failure", "chance", "rounding")
    listed = reporting.Items(tuple(reporting.paragraph(f"decision_{rule}", tests=tests, **values) for rule in rules))
    return Section("Decision rule", (listed, Text(reporting.paragraph("decision_conformity"))))


def residuals_picture(fit: Fit) -> Picture:
    """Return the residuals of both wheels."""
    sizes = {name: 1e6 * float(abs(wheel.residual_m).max()) for name, wheel in fit.wheels.items()}
    alt = "Residuals of both wheels: " + "; ".join(f"{name} wheel within {um:.0f} µm" for name, um in sizes.items())
    colours = "; colours are sessions as above" if len(set(fit.radii.session.tolist())) > 1 else ""
    draw = partial(reporting.drawn, "calibration.residuals", fit.left, fit.right, fit.radii.session)
    return Picture("residuals", caption("residuals", colours=colours), alt, draw)


MM: Final = 1e3
UM: Final = 1e6


def law_table(fit: Fit) -> Table:
    """Return both wheels' laws with expanded uncertainties."""
    left, right = fit.left.law.reference_load_N, fit.right.law.reference_load_N
    zero = f"F₀ = {left:.4g} N" + ("" if left == right else f" (left), {right:.4g} N (right)")
    return _table(caption("table-law", zero=zero), fit.wheels)


def static_table(fit: Fit) -> Table:
    """Return the same regression on the standing wheels."""
    return _table("Static radius against load, the same regression on the standing wheel; U as above.", fit.static)


def _table(title: str, wheels: Mapping[str, WheelFit]) -> Table:
    radius = tuple(f"Radius at F₀ | {head}" for head in ("r(F₀) (mm)", "U (mm)", "k"))
    slope = tuple(f"Slope | {head}" for head in ("s (µm/N)", "U (µm/N)", "k"))
    rows = [(name, *_row(wheel)) for name, wheel in wheels.items()]
    return table(title, ("<Wheel", "Runs", "^Loads (N)", *radius, *slope), rows)


def coefficients_in_units(fit: WheelFit) -> list[tuple[str, str, float, float, float]]:
    """Return the coefficients of a wheel: title, unit, value, standard uncertainty and its degrees of freedom."""
    law, (radius_std, slope_std) = fit.law, np.sqrt(np.diag(fit.law.covariance)).tolist()
    title = f"radius at {law.reference_load_N:.4g} N"
    rows = [(title, "mm", MM * law.radius_ref_m, MM * radius_std, fit.dof_radius_ref)]
    if fit.model == "line":
        rows.append(("slope", "µm/N", UM * law.slope_m_per_N, UM * slope_std, fit.dof_slope))
    return rows


def _row(fit: WheelFit) -> tuple[str, ...]:
    cells: list[str] = []
    for _, _, value, std, dof in coefficients_in_units(fit):
        k = float(t_quantile(dof))
        cells += [*measured(value, k * std), fixed(k, 2)]
    cells += [MISSING] * (6 - len(cells))
    return (str(fit.law.n_runs), span(fit.law.load_min_N, fit.law.load_max_N, "", ".0f").replace(" to ", "–"), *cells)


def _single_run_text(fit: Fit) -> Text:
    parts = []
    line = any(wheel.model == "line" for wheel in fit.wheels.values())
    for name, wheel in fit.wheels.items():
        half = wheel.law.half_width_m(0.5 * (wheel.law.load_min_N + wheel.law.load_max_N), single_run=True)
        parts.append(f"±{two_digits(UM * float(half))} µm ({name})")
    return Text(
        f"The radius that one further run shows lies, with 95 % probability, within {' and '.join(parts)} of the law "
        + ("in the middle of the load range." if line else "at this load.")
    )


def quality_text(wheel: WheelFit) -> str:
    """Return the scatter about the law, and what it explains."""
    text = f"{wheel.wheel.capitalize()} wheel: residual standard deviation {two_digits(UM * wheel.residual_std_m)} µm"
    if wheel.model == "line":
        text += f", R² = {wheel.r_squared:.5f}" if wheel.r_squared > 0.99 else f", R² = {wheel.r_squared:.3f}"
    return text + "."


def regressions_picture(fit: Fit) -> Picture:
    """Return both laws with their bands."""
    alt = f"Regression of the radius on the load: {'; '.join(map(_law_in_words, fit.wheels.values()))}"
    return picture("regressions", alt, "calibration.regressions", fit.left, fit.right, fit.radii.session)


def _law_in_words(wheel: WheelFit) -> str:
    law = wheel.law
    if wheel.model != "line":
        return f"{wheel.wheel} wheel: constant radius {1e3 * law.radius_ref_m:.4f} mm"
    change = "grows" if law.slope_m_per_N > 0 else "shrinks"
    return f"{wheel.wheel} wheel: the radius {change} by {abs(1e6 * law.slope_m_per_N):.3g} µm for each newton"


def radius_budget(fit: Fit) -> Table:
    """Return the budget of a single effective radius."""
    rows: list[tuple[str, ...]] = []
    for part in fit.radii.budget:
        name, dof = part.name.replace("_", " "), "∞" if part.dof is None else fixed(part.dof, 1)
        sizes = (two_digits(1e6 * std_m) for std_m in (part.std_left_m, part.std_right_m))
        rows.append((name, prose(part.what), part.kind, part.distribution, dof, *sizes))
    total = np.linalg.norm([(part.std_left_m, part.std_right_m) for part in fit.radii.budget], axis=0)
    combined = (two_digits(1e6 * float(std_m)) for std_m in total)
    rows.append(("combined", "one run in a session of its own", "", "", "", *combined))
    heads = ("<Contribution", "*Quantity", "^Type", "<Distribution", "~ν", "u | left (µm)", "u | right (µm)")
    return table(caption("table-radius-budget"), heads, aligned(rows, 5, 6))


def budget_picture(fit: Fit) -> Picture:
    """Return the budget of a single radius as bars."""
    largest = max(fit.radii.budget, key=lambda part: part.std_left_m + part.std_right_m)
    alt = f"Bars of the uncertainty budget; the largest contribution is {largest.name.replace('_', ' ')}"
    return picture("budget", alt, "calibration.budget_bars", fit.radii.budget)


#: more runs make the report's table one of sessions
MOST_ROWS: Final = 200
MOST_NAMED: Final = 12


def left_out_table(fit: Fit) -> Table:
    """Return a row a reason, a dozen unused runs named; the fit's JSON names them all."""
    by_reason = grouped((run.reason, run.run_id) for run in fit.radii.left_out)
    rows = [(reason, str(len(names)), listed(names, MOST_NAMED)) for reason, names in by_reason.items()]
    return table("Runs that were not used.", ("*Reason", "Number", "*Runs"), rows[:MOST_ROWS], dense=True)


def runs_table(fit: Fit) -> Table:
    """Return a row a run."""
    radii = fit.radii
    numbers: dict[str, tuple[FloatArray, float, int]] = {"~Distance (m)": (radii.distance_m, 1.0, 4)}
    encoder = None if fit.setup is None else fit.setup.encoder
    for side in SIDES if encoder is not None else ():
        path, radius_m = getattr(radii, f"path_{side}"), getattr(radii, f"radius_{side}_m")
        per_rev = getattr(encoder, f"counts_per_rev_{side}")
        numbers[f"~Counts | {side}"] = (radii.distance_m * (1 + path) / (2 * np.pi * radius_m) * per_rev, 1.0, 0)
    for head, factor, decimals, left, right in (
        ("Load | {} (N)", 1.0, 1, radii.load_left_N, radii.load_right_N),
        ("Radius | {} (mm)", 1e3, 4, radii.radius_left_m, radii.radius_right_m),
        ("~Path | {} (ppm)", 1e6, 0, radii.path_left, radii.path_right),
        ("Residual | {} (µm)", 1e6, 1, fit.left.residual_m, fit.right.residual_m),
    ):
        numbers[head.format("left")] = (left, factor, decimals)
        numbers[head.format("right")] = (right, factor, decimals)
    labels = [array.astype(str).tolist() for array in (radii.run_id, radii.session, radii.direction)]
    cells = [[fixed(factor * value, places) for value in array.tolist()] for array, factor, places in numbers.values()]
    rows = zip(*labels, *cells, strict=True)
    return table(caption("table-runs"), ("<Run", "<Session", "<Dir.", *numbers), rows, dense=True)


def runs_picture(fit: Fit) -> Picture:
    """Return the radius of every run in the order driven."""
    parts = []
    for name, wheel in fit.wheels.items():
        low, high = 1e3 * float(wheel.radius_m.min()), 1e3 * float(wheel.radius_m.max())
        parts.append(f"{name} wheel {low:.3f} to {high:.3f} mm")
    alt = f"Radius by run for both wheels, {len(fit.radii)} runs: {'; '.join(parts)}"
    return picture("runs-by-series", alt, "calibration.runs_by_series", fit.radii)


def deviation_picture(fit: Fit) -> Picture:
    """Return what weaving and turning added to the paths."""
    radii = fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    worst = 1e6 * float(np.abs((radii.path_left, radii.path_right)).max())
    shown = f"Excess of the path by amplitude for five wavelengths with {int(known.sum())} runs"
    alt = f"{shown}; corrections of all runs up to {worst:.0f} ppm"
    return picture("path-deviation", alt, "calibration.path_deviation", radii)


#: failed checks of a fit that further runs alone mend
_OF_MISSING_RUNS: Final = frozenset({"design", "order"})
#: the only check that fails -> the step
_OF_ONE_CHECK: Final = {"direction": "fit one way", "temperature": "fit varies"}


def after_fit(fit: Fit) -> str:
    """Return the step that a fit was: runs are missing only where nothing else fails."""
    failed = {check.name for _, check in fit.failed_checks}
    if len(failed) == 1 and (step := _OF_ONE_CHECK.get(*failed)):
        return step
    return "fit" if not failed else "fit lacks runs" if failed <= _OF_MISSING_RUNS else "fit failed"
