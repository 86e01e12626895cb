"""A cause has one size on all runs; what imitates it differs from group to group."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
import pytest
import statsmodels.api as sm
from scipy import stats

from calib.campaign.model import Campaign
from calib.challenge import Seeds, read_seeds, recipes
from calib.challenge.cases import campaigns_of, truth_of
from calib.gap.decision import constancy
from calib.gap.decision.constancy import SizeDifference, _difference, beside_named_steps, half_of_mean, size_differences
from calib.gap.decision.diagnosis import Cause, Diagnosis, Quantity
from calib.gap.diagnose import diagnose_in_full
from calib.gap.inference import FALSE_REJECTION, FORM_ERROR

#: cases of development, and the one of them that `tests.challenge.fixes` recommended a wrong fix for
CASES = Seeds(
    "development", 880001, {"deleted": 150, "outside": 54, "crowded": 30, "single": 120, "pair": 24, "empty": 10}
)
IMITATED = "c0073"

Array = npt.NDArray[np.float64]
N_ROWS = 120
#: the noise of the linear model is known, so that its degrees of freedom are many
MANY = 1e9
#: the prior of a difference is a hundred times the size, and so is that of the common size: 1e-4 of what data say
PRIOR_SHARE = 1e-3
#: of 400 draws a true level of 5 % gives 20, with a standard deviation of 4.4: four of them
DRAWS, LARGEST_COUNT = 400, 38


def ordinary_fit(columns: Array, gap: Array) -> SimpleNamespace:
    """A fit of whitened rows by least squares, a row a run, in the shape that the test asks for."""

    def solve(every: Array, precision: Array) -> tuple[Array, Array]:
        covariance = np.linalg.inv(every.T @ every + np.diag(precision))
        return covariance @ every.T @ gap, covariance

    system = SimpleNamespace(blocks=SimpleNamespace(unit=np.arange(len(gap))))
    weighting = SimpleNamespace(system=system, solve=solve)
    return SimpleNamespace(
        columns=columns, precision=np.full(columns.shape[1], 1e-4), weighting=weighting, noise=SimpleNamespace(dof=MANY)
    )


def drawn(rng: np.random.Generator, sizes: dict[str, float]) -> tuple[Array, Array, npt.NDArray[np.str_]]:
    """An effect (n_rows,) that has a size of its own on each group beside one nuisance, the gap, and the labels."""
    labels = np.array(list(sizes))[np.arange(N_ROWS) % len(sizes)]
    effect, nuisance = rng.normal(size=N_ROWS), rng.normal(size=N_ROWS)
    gap = effect * np.array([sizes[label] for label in labels]) + 2.0 * nuisance + rng.normal(size=N_ROWS)
    return np.column_stack([nuisance, effect]), gap, labels


def difference(
    columns: Array, gap: Array, labels: npt.NDArray[np.str_], beside: Array | None = None
) -> SizeDifference | None:
    fit = ordinary_fit(columns, gap)
    return _difference(fit, "effect", columns[:, 1], "kind", labels, beside)  # type: ignore[arg-type]


def test_the_p_value_is_that_of_the_sizes_that_a_regression_gives_each_group() -> None:
    """Wald's test on statsmodels' sizes by group, known noise, and what sizes may differ by beside it."""
    from scipy.stats import chi2

    columns, gap, labels = drawn(np.random.default_rng(1), {"a": 1.0, "b": 1.3, "c": 0.8})
    by_group = np.column_stack([columns[:, 1] * (labels == value) for value in ("a", "b", "c")])
    each = sm.OLS(gap, np.column_stack([columns[:, 0], by_group])).fit()
    found = difference(columns, gap, labels)
    assert found is not None
    place = {"a": 1, "b": 2, "c": 3}
    contrast = np.zeros((2, 4))
    others = [value for value in place if value != found.reference]
    for row, value in enumerate(others):
        contrast[row, [place[value], place[found.reference]]] = 1.0, -1.0
    change = contrast @ each.params
    spread = contrast @ (each.normalized_cov_params + np.diag([0.0, *3 * [FORM_ERROR**2]])) @ contrast.T
    statistic = float(change @ np.linalg.solve(spread, change))
    assert found.p_value == pytest.approx(chi2.sf(statistic, 2), rel=PRIOR_SHARE * statistic)
    assert found.ratio == pytest.approx(1.0 + change[others.index(found.value)], rel=PRIOR_SHARE)


def test_sizes_a_twentieth_apart_are_the_same_however_precise_the_runs() -> None:
    columns, gap, labels = drawn(np.random.default_rng(4), {"a": 1.0, "b": 1.05})
    precise = difference(1e3 * columns, gap + (1e3 - 1.0) * columns[:, 1] * np.where(labels == "a", 1.0, 1.05), labels)
    assert precise is not None and precise.p_value > 0.05
    far = difference(1e3 * columns, gap + (1e3 - 1.0) * columns[:, 1] * np.where(labels == "a", 1.0, 1.5), labels)
    assert far is not None and far.p_value < 1e-6


def test_equal_sizes_are_rejected_as_rarely_as_stated() -> None:
    rng = np.random.default_rng(2)
    rejected = 0
    for _ in range(DRAWS):
        found = difference(*drawn(rng, {"a": 1.0, "b": 1.0, "c": 1.0, "d": 1.0}))
        rejected += found is not None and found.p_value < 0.05
    assert 0 < rejected < LARGEST_COUNT


def test_the_p_value_that_is_said_counts_all_tests_of_the_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    """One in twenty campaigns doubts a cause by chance, however many groupings are tried.

    An effect that may act beside is tried by a test of its own.
    """
    found = SizeDifference("wear", "speed", "a", "b", 2.0, 0.1, 0.01)
    stubs = {"_contributions": {"wear": None}, "_beside": ()}
    for name, value in stubs.items():
        monkeypatch.setattr(constancy, name, lambda *_, value=value: value)
    monkeypatch.setattr(constancy, "_difference", lambda *of: replace(found, by=of[3], p_value=of[-1] or 0.01))
    evidence = SimpleNamespace(
        effects={"wear": SimpleNamespace(per_session=False)}, search=SimpleNamespace(weighting=0)
    )
    evidence.fitted = evidence.nominal = evidence.noise = evidence.observations = evidence.left_out = None
    for tests, p_value in ((4, 0.04), (5, None)):
        monkeypatch.setattr(constancy, "groupings", lambda *_, tests=tests, **__: dict.fromkeys(range(tests)))
        differing = size_differences(evidence, ["wear"])  # type: ignore[arg-type]
        assert {"wear": p_value} == {"wear": differing["wear"].p_value if differing else None}
    monkeypatch.setattr(constancy, "groupings", lambda *_, **__: dict.fromkeys(range(4)))
    for beside, differs in (((0.02,), True), ((0.02, 0.1), False)):
        monkeypatch.setattr(constancy, "_beside", lambda *_, beside=beside: beside)
        assert bool(size_differences(evidence, ["wear"])) is differs  # type: ignore[arg-type]


def test_what_another_effect_accounts_for_is_no_difference() -> None:
    """One size everywhere, and an effect of its own that acts on one group; another that acts there otherwise."""
    columns, gap, labels = drawn(np.random.default_rng(5), {"a": 1.0, "b": 1.0})
    beside, otherwise = np.where(labels == "b", columns[:, 1], 0.0), np.random.default_rng(6).normal(size=N_ROWS)
    gap = gap + 0.8 * beside
    levels = [difference(columns, gap, labels, other) for other in (None, beside[:, None], otherwise[:, None])]
    assert [each is not None and each.p_value < FALSE_REJECTION for each in levels] == [True, False, True]


def test_a_group_on_which_the_effect_does_nothing_says_nothing() -> None:
    columns, gap, labels = drawn(np.random.default_rng(3), {"a": 3.0, "b": 3.0})
    columns[labels == "b", 1] = 0.0
    assert difference(columns, gap, labels) is None


def test_a_true_cause_has_one_size(diagnosed_sample: Callable[[str], tuple[Campaign, Diagnosis]]) -> None:
    """Radii that follow the temperature in the yard."""
    _, diagnosis = diagnosed_sample("yard")
    assert diagnosis.evidence is not None and diagnosis.causes
    assert size_differences(diagnosis.evidence, diagnosis.evidence.named) == {}


@pytest.fixture
def without_rivals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw a case without its rivals and its ceiling, which enter the score alone, and no campaign."""
    monkeypatch.setattr("calib.challenge.cases.alternatives", lambda *_: None)
    monkeypatch.setattr("calib.challenge.cases.rivals", lambda _: ())
    monkeypatch.setattr("calib.challenge.cases._ceilings", lambda *_: (None, None))


@pytest.mark.usefixtures("without_rivals")
def test_what_imitates_a_cause_is_not_recommended() -> None:
    """Radii that follow the speed, in a library without them: a slip at stops is no cause at all speeds."""
    recipe = next(recipe for recipe in recipes(CASES) if recipe.case == IMITATED)
    assert recipe.deleted == "speed_radius"
    truth = truth_of(recipe, CASES.seed, 160)
    campaign, _ = campaigns_of(truth)
    diagnosis = diagnose_in_full(campaign, plan=False, exclude=("speed_radius",))
    assert not diagnosis.recommended
    assert any("differs by speed" in reason for reason in diagnosis.fix.why)


@pytest.mark.usefixtures("without_rivals")
@pytest.mark.parametrize(("case", "cause", "imitation"), [("c0026", "lost_counts", "speed_radius")])
def test_what_a_second_form_of_the_cause_explains_is_no_second_cause(
    project_root: Path, case: str, cause: str, imitation: str
) -> None:
    """Counts lost with the square of the speed, a form that is not offered: the rest of its law is no radius."""
    seeds = read_seeds(project_root / "tests" / "challenge" / "seeds" / "scoring15.toml")
    recipe = next(recipe for recipe in recipes(seeds) if recipe.case == case)
    campaign, _ = campaigns_of(truth_of(recipe, seeds.seed, 160))
    diagnosis = diagnose_in_full(campaign, plan=False)
    assert [one.effect for one in diagnosis.causes] == [cause]
    assert diagnosis.recommended and any(imitation in note for note in diagnosis.notes)


def test_in_a_crowd_with_an_outside_effect_a_zone_of_the_floor_is_no_cause(project_root: Path) -> None:
    """Three effects and one that no library has: what acts on one speed alone is followed by a place of the floor."""
    seeds = read_seeds(project_root / "tests" / "challenge" / "seeds" / "scoring15.toml")
    recipe = next(recipe for recipe in recipes(seeds) if recipe.case == "c0034")
    campaign, _ = campaigns_of(truth_of(recipe, seeds.seed, 160))
    diagnosis = diagnose_in_full(campaign, plan=False)
    assert {one.effect for one in diagnosis.causes} <= {"travel_direction", "load_creep", "rear_drag"}
    assert diagnosis.unexplained is not None and diagnosis.unexplained.where[0].startswith("on the floor, x")
    assert diagnosis.probabilities["floor_zone"] <= 0.5 <= diagnosis.probabilities["unknown"]


def test_the_interval_of_a_mean_of_sessions_is_that_of_student() -> None:
    """By another library, and by what it holds: of independent sessions about zero one in twenty excludes it."""
    rng = np.random.default_rng(7)
    draws = rng.normal(0.0, 3e-4, (2000, 4))
    half = np.array([half_of_mean(results) for results in draws])
    low, high = stats.t.interval(0.95, 3, loc=draws.mean(axis=1), scale=stats.sem(draws, axis=1))
    np.testing.assert_allclose(half, 0.5 * (high - low), rtol=1e-12)
    # 0.05 +- 3 standard errors of a share of 2000
    assert 0.035 < np.mean(np.abs(draws.mean(axis=1)) > half) < 0.065


def test_radii_beside_steps_of_the_sessions_are_the_mean_of_sessions() -> None:
    """Their intervals hold the scatter of these: of two radii that step alike, the scale's; against each other, the
    difference's.
    """
    names = [f"{side}_{session}" for session in ("b", "c") for side in ("left", "right")]
    radii = {name: Cause(name, "", "", 0.9, 0.5, 30.0, {"relative": Quantity(1e-3, (9e-4, 1.1e-3), "1")})
             for name in ("radius_scale", "unequal_radii", "track_width")}  # fmt: skip
    for signs, stepping in (((1, 1), "radius_scale"), ((-1, 1), "unequal_radii")):
        sizes = dict(zip(names, np.outer([4e-4, -2e-4], signs).ravel().tolist(), strict=True))
        steps = Cause("session_step", "", "", 0.9, 0.5, 30.0, {n: Quantity(v, (v, v), "1") for n, v in sizes.items()})
        widened = {one.effect: one for one in beside_named_steps([*radii.values(), steps], ["b", "c"])}
        # of left and right against each other by 4e-4 each, the difference is 8e-4
        results = np.array([0.0, 4e-4, -2e-4]) * (1.0 if stepping == "radius_scale" else 2.0)
        half = float(np.hypot(1e-4, half_of_mean(results)))
        for name, one in widened.items():
            if name == stepping:
                assert one.parameters["relative"].ci95 == pytest.approx((1e-3 - half, 1e-3 + half))
                assert "mean of 3 sessions" in one.remark
            elif name in radii:
                assert one.parameters["relative"].ci95 == pytest.approx((9e-4, 1.1e-3))
    assert [one.remark for one in beside_named_steps(list(radii.values()), ["b", "c"])] == ["", "", ""]


def test_of_a_step_that_lasts_the_mean_is_that_of_all_sessions() -> None:
    """The first two of four sessions are as before."""
    step = {f"{side}_c": Quantity(4e-4, (3e-4, 5e-4), "1") for side in ("left", "right")}
    causes = [
        Cause("radius_scale", "", "", 0.9, 0.5, 30.0, {"relative": Quantity(1e-3, (9e-4, 1.1e-3), "1")}),
        Cause("session_step", "", "from c on", 0.9, 0.5, 30.0, step),
    ]
    radius, _ = beside_named_steps(causes, ["b", "c", "d"])
    half = float(np.hypot(1e-4, half_of_mean(np.array([0.0, 0.0, 4e-4, 4e-4]))))
    assert radius.parameters["relative"].ci95 == pytest.approx((1e-3 - half, 1e-3 + half))
    assert "mean of 4 sessions" in radius.remark
