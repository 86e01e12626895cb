"""Result of a fit, its checks, and its comparison with a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from calib.campaign.checks.design import WEIGHTY
from calib.radius.checks import FAIL_BELOW, NOTE_BELOW
from calib.radius.regression import Check
from calib.radius.result import Difference, Fit, ModelComparison
from calib.reporting import blocks
from calib.reporting.blocks import (
    Block,
    Notice,
    Picture,
    Section,
    Table,
    Text,
    caption,
    items,
    paragraph,
    picture,
    table,
)
from calib.reporting.formatting import fixed, places, plural, probability, prose, span
from calib.reporting.source import Source
from calib.reporting.topics import law
from calib.reporting.topics.law import law_table, radius_budget, regressions_picture, single_run_text, static_table
from calib.reporting.topics.runs import deviation_picture, left_out_table, runs_picture, runs_table
from calib.types import grouped

#: in the order of the report's pages
FIT_PICTURES: Final = ("runs-by-series", "regressions", "path-deviation", "residuals", "budget")


def fit_content(fit: Fit, *, runs: bool = False) -> tuple[Block | Section, ...]:
    """Return what a fit says; with `runs` the radius of every run, too."""
    sessions = len(set(fit.radii.session.tolist()))
    return (
        blocks.Heading(f"{fit.name}: {plural(len(fit.radii), 'run')} in {plural(sessions, 'session')}"),
        *([blocks.simulated_notice()] if fit.simulated else []),
        law_table(fit),
        single_run_text(fit),
        Text(" ".join(map(law.quality_text, fit.wheels.values()))),
        *law.naive_text(fit),
        *([static_table(fit)] if fit.static else []),
        checks_table(fit),
        *([radius_budget(fit)] if fit.radii.budget else []),
        *([runs_table(fit)] if runs else []),
        *items(map(prose, fit.notes)),
        *([left_out_table(fit)] if fit.radii.left_out else []),
        usable_notice(fit),
    )


def comparison_content(compared: ModelComparison, notes: Sequence[str]) -> tuple[Block, ...]:
    """Return a fitted law held against a model's."""
    kinds = {"radius_ref": (f"radius at {compared.reference_load_N:.0f} N", 1e3, "mm"), "slope": ("slope", 1e6, "µm/N")}
    rows = [_row(one, *kinds[one.quantity]) for one in compared.differences]
    interval = ("95 % interval | from", "95 % interval | to")
    heads = ("<Quantity", "<Unit", "Fitted", "Model", "Difference", *interval, "<Model lies")
    exact = "; the model states no uncertainty, its values are taken as exact" if compared.exact else ""
    caption = f"Fitted law against the model's; the interval is that of the difference{exact}."
    return (table(caption, heads, rows), *items(map(prose, notes)))


def _row(difference: Difference, name: str, factor: float, unit: str) -> tuple[str, ...]:
    low, high = (factor * end for end in difference.ci95)
    decimals = places(0.5 * (high - low))
    values = (factor * difference.fitted, factor * difference.model, factor * difference.difference, low, high)
    numbers = (fixed(value, decimals) for value in values)
    return (f"{difference.wheel}: {name}", unit, *numbers, "inside" if difference.inside else "OUTSIDE")


def result_section(source: Source) -> Section:
    """Return the laws in a table, and the checks' verdict."""
    fit = source.fit
    laws = [wheel.law for wheel in fit.wheels.values()]
    ranges = [span(one.load_min_N, one.load_max_N, "N", ".0f") for one in laws]
    loads = ranges[0] if ranges[0] == ranges[1] else f"{ranges[0]} (left wheel) and {ranges[1]} (right wheel)"
    holds = Text(paragraph("law_holds", loads=loads, runs=len(fit.radii)))
    assumed = assumed_notice(source.setup.assumed)
    return Section("Result", (law_table(fit), holds, single_run_text(fit), usable_notice(fit), *assumed, *_gap(source)))


def assumed_text(assumed: Mapping[str, str]) -> Text:
    """Return unstated keys of ``campaign.toml``, with the values assumed."""
    if not assumed:
        return Text("Every setting that these results depend on is stated by the campaign; none is assumed.")
    return Text(
        f"Assumed, not stated by the campaign: {_listed(assumed)}. Results that depend on these are not measured."
    )


def assumed_notice(assumed: Mapping[str, str]) -> tuple[Notice, ...]:
    """Return a notice where every result scales with an assumed value."""
    weighty = {key: value for key, value in assumed.items() if key in WEIGHTY}
    if not weighty:
        return ()
    text = f"{_listed(weighty)}. Every radius or path scales with these: state the vehicle's own in campaign.toml."
    return (Notice("note", "Assumed, since the campaign does not state it", text),)


def _listed(assumed: Mapping[str, str]) -> str:
    return ", ".join(f"{key} = {value}" if value else key for key, value in assumed.items())


def diagnosis_section(source: Source) -> Section | None:
    """Return the findings of the diagnosis, if any."""
    if source.verdict is None:
        return None
    from calib.reporting.topics.diagnosis import gap_section

    return gap_section(source.verdict, source.gap)


def _gap(source: Source) -> tuple[Notice, ...]:
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
    return (*(picture(fit) for picture in draw), *((law.budget_picture(fit),) if fit.radii.budget else ()))


def fit_brief(fit: Fit) -> tuple[Block, ...]:
    """Return what the interpreter shows of a fit."""
    return (law_table(fit), usable_notice(fit))


_LEVELS: Final = {"ok": "passed", "note": "remark", "failed": "FAILED"}
#: beside the result
MAX_REMARKS: Final = 3


def checks_table(fit: Fit) -> Table:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    by_name: dict[str, dict[tuple[str, str], dict[str, Check]]] = {}
    for wheel, fitted in fit.wheels.items():
        for check in fitted.checks:
            by_name.setdefault(check.name, {}).setdefault((check.level, check.sentence), {})[wheel] = check
    rows = [
        (
            name.replace("_", " "),
            "both" if len(same) == 2 else next(iter(same)),
            _LEVELS.get(level, level),
            _statistics(list(same.values())),
            " / ".join(dict.fromkeys(probability(check.p_value) for check in same.values())),
            prose(sentence),
        )
        for name, results in by_name.items()
        for (level, sentence), same in results.items()
    ]
    heads = ("<Check", "<Wheel", "<Verdict", "*~Statistic", "~p", "*Meaning")
    return table(caption("table-checks"), heads, rows, dense=True)


def _statistics(checks: list[Check]) -> str:
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
        said = [text if len(wheels) > 1 else wheels[0] + text for text, wheels in remarks.items()]
        return Notice("note", "The law can be used; its user has to know this", " ".join(said[:MAX_REMARKS]))
    return Notice("good", "The law can be used", "Every check of the fit passed without remark.")


def residuals_section(source: Source) -> Section:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    fit = source.fit
    return Section("Residual checks", (residuals_picture(fit), checks_table(fit)))


def decision_section(source: Source) -> Section:
    """Return the rule that judged the checks, and what was not judged."""
    tests = sum(check.p_value is not None for wheel in source.fit.wheels.values() for check in wheel.checks)
    false_alarm = 100 * (1 - (1 - NOTE_BELOW) ** tests)
    values = {"note": NOTE_BELOW, "fail": FAIL_BELOW, "false_alarm": false_alarm, "failures": 100 * tests * FAIL_BELOW}
    rules = ("remark", "failure", "chance", "rounding")
    listed = blocks.Items(tuple(paragraph(f"decision_{rule}", tests=tests, **values) for rule in rules))
    return Section("Decision rule", (listed, Text(paragraph("decision_conformity"))))


def residuals_picture(fit: Fit) -> Picture:
    """Return the residuals of both wheels."""
    sizes = {name: 1e6 * float(abs(wheel.residual_m).max()) for name, wheel in fit.wheels.items()}
    alt = "Residuals of both wheels: " + "; ".join(f"{name} wheel within {um:.0f} µm" for name, um in sizes.items())
    return picture("residuals", alt, "calibration.residuals", fit.left, fit.right, fit.radii.session)
