"""From a campaign to a diagnosis, on cases whose outcome is known by hand."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.errors import RefusedError
from calib.gap.decision.decide import decide
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.diagnose import diagnose_in_full
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan.next_runs import read_plan
from calib.gap.plan.planned_runs import joined
from calib.radius.fit import fit_campaign
from calib.vehicle import Vehicle
from tests.gap.effects.making import ROUTE, SQUARE, Motion, Run, campaign, rich_runs

Diagnosed = Callable[[str], tuple[Campaign, Diagnosis]]
FIELDS = {
    "verdict": str,
    "causes": list,
    "credible_sets": list,
    "indistinguishable": list,
    "undetectable": dict,
    "where": dict,
    "closure": dict,
    "recommended": bool,
    "next_runs": list,
}
CLOSURE = {"before_rms_m", "after_rms_m", "floor_rms_m", "fraction", "ci95", "held_out"}
#: relative change of both radii a kelvin; plausible, and many noise levels over 20 K
WARMTH = 2e-4
VERDICTS = {"no_gap", "explained", "partly_explained", "ambiguous", "unknown", "undecided"}


def rich_campaign(seed: int = 1, warmth: float = 0.0, factor: float = 1.0) -> Campaign:
    """Rich runs with instruments that scatter as stated, warm wheels and a factor on the left counts."""
    rng = np.random.default_rng(seed)

    def truth(run: Run, now: Motion) -> None:
        now.left = now.right = warmth * (run.numbers["temperature_C"] - 20.0)
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [0.0015, 0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    # no front wheel: no steered wheel follows a route whose curvature jumps
    built = campaign([replace(run, front=False) for run in rich_runs()], truth=truth)
    for table in (built.runs.numbers, built.logs.columns):
        table["counts_left"] *= factor
    return built


@pytest.fixture(scope="module")
def corridor(diagnosed_sample: Diagnosed) -> Diagnosis:
    return diagnosed_sample("corridor")[1]


@pytest.fixture(scope="module")
def crossed_campaign(diagnosed_sample: Diagnosed) -> Campaign:
    return diagnosed_sample("corridor_crossed")[0]


@pytest.fixture(scope="module")
def crossed(diagnosed_sample: Diagnosed) -> Diagnosis:
    return diagnosed_sample("corridor_crossed")[1]


@pytest.fixture(scope="module")
def sound() -> Diagnosis:
    return diagnose_in_full(rich_campaign(), plan=False)


@pytest.fixture(scope="module")
def faulty() -> Diagnosis:
    return diagnose_in_full(rich_campaign(factor=4.0, warmth=WARMTH), plan=False)


def test_the_corrections_of_load_and_session_differ_on_journeys_by_the_load_law(
    corridor: Diagnosis, project_root: Path, tmp_path: Path
) -> None:
    """On sessions to come a step of the old ones does nothing: 200 kg more move the two apart as the law moves ends."""
    plan = (project_root / "sample_runs/plan.toml").read_text("utf-8")
    head = plan[: plan.index("[[runs]]")]
    campaign = read_campaign(project_root / "sample_runs/corridor")
    evidence, apart = corridor.evidence, []
    assert evidence is not None
    for payload in (0, 200):
        file = tmp_path / f"{payload}.toml"
        file.write_text(f'{head}[[runs]]\nkind = "corridor"\npayload_kg = {payload}\npayload_x_m = 0.0\n', "utf-8")
        journeys = read_plan(file)
        # the unladen journeys by the decision alone, which is all that journeys enter
        to_come = observations_of(joined(campaign, journeys), evidence.observations.model)
        whole = diagnose_in_full(campaign, journeys=journeys, plan=False) if payload else None
        fix = (whole or decide(replace(evidence, journeys=to_come))).fix
        assert fix.agreement_on == "journeys" and fix.agreement_m is not None
        apart.append(fix.agreement_m)
    slopes = {cause.effect: cause for cause in corridor.causes}["load_radius"].parameters
    way_m, track_m, load_N = 40.0, 0.7, 200 * 9.81 / 2
    left, right = (way_m * slopes[f"slope_{side}"].value * load_N / 0.1 for side in ("left", "right"))
    moved_m = float(np.hypot((left + right) / 2, way_m * (right - left) / track_m / 2))
    # the triangle of the two distances and what the load moves; a path bent by metres is no straight line: 5 %
    assert abs(apart[1] - apart[0]) <= 1.05 * moved_m
    assert apart[0] + apart[1] >= 0.95 * moved_m


def test_a_share_lies_in_its_interval_and_a_sole_cause_carries_what_is_explained(crossed: Diagnosis) -> None:
    """The uncertainty is that of the sizes and of the noise; a sole cause has the whole closure."""
    (cause,) = crossed.causes
    assert cause.share_ci95 is not None
    low, high = cause.share_ci95
    assert 0.0 <= low <= cause.share <= high <= 1.0
    # a gap of 70 noise levels: what noise adds to its squares is less than a hundredth of them
    assert high - low < 0.02


def test_one_load_a_session_confounds_load_and_session(corridor: Diagnosis) -> None:
    """One load a session cannot separate the two; a run that does is recommended, with its reason."""
    assert corridor.kind is VerdictKind.AMBIGUOUS
    assert any({"load_radius", "session_step"} <= set(group) for group in corridor.groups)
    assert not corridor.recommended
    assert any("load_radius" in run.why and "session_step" in run.why for run in corridor.next_runs)


def test_sizes_of_a_load_that_was_driven_in_one_direction_alone_are_said_to_hold_what_the_direction_does(
    project_root: Path,
) -> None:
    recorded = read_campaign(project_root / "sample_runs" / "corridor_crossed")
    payload, out = recorded.runs.number("payload_kg"), recorded.runs.label("direction") == "out"
    together = ((payload == 200.0) & out) | ((payload == 0.0) & ~out)
    runs = replace(recorded.runs, excluded=recorded.runs.excluded | ~together)
    diagnosis = diagnose_in_full(replace(recorded, runs=runs), plan=False)
    assert [cause.effect for cause in diagnosis.causes] == ["load_radius"]
    assert "load and direction change together: sizes hold if only one of the two acts" in diagnosis.sentence


def test_crossed_loads_name_the_load_with_the_slopes_of_the_regression(
    crossed: Diagnosis, crossed_campaign: Campaign
) -> None:
    """Slopes from paths and slopes from radii agree within the interval of the regression."""
    assert crossed.kind is VerdictKind.EXPLAINED
    assert [cause.effect for cause in crossed.causes] == ["load_radius"]
    fitted = fit_campaign(crossed_campaign)
    for side, wheel in (("left", fitted.left), ("right", fitted.right)):
        assert wheel.slope_ci95_m_per_N is not None
        low, high = wheel.slope_ci95_m_per_N
        quantity = crossed.causes[0].parameters[f"slope_{side}"]
        assert low <= quantity.value <= high
        assert quantity.ci95[0] <= quantity.value <= quantity.ci95[1]
    assert crossed.closure.fraction is not None and crossed.closure.fraction > 0.9
    assert crossed.recommended
    assert crossed.next_runs == ()


def test_a_model_that_is_right_has_no_gap(sound: Diagnosis) -> None:
    assert sound.kind is VerdictKind.NO_GAP
    assert sound.causes == ()
    assert sound.groups == ()
    assert not sound.recommended
    assert sound.closure.fraction is None


def test_an_effect_is_named_with_its_size_and_excluded_on_request() -> None:
    """Radii that follow the temperature: named within its interval; excluded, it is neither named nor offered."""
    warm = rich_campaign(warmth=WARMTH)
    diagnosis = diagnose_in_full(warm, plan=False)
    assert diagnosis.kind is VerdictKind.EXPLAINED
    assert [cause.effect for cause in diagnosis.causes] == ["temperature_radius"]
    low, high = diagnosis.causes[0].parameters["alpha"].ci95
    assert low <= WARMTH <= high
    without = diagnose_in_full(warm, exclude=("temperature_radius",), plan=False)
    assert "temperature_radius" not in json.dumps(
        [without.to_dict()[name] for name in ("probabilities", "credible_sets", "indistinguishable", "undetectable")]
    )
    assert without.kind is not VerdictKind.NO_GAP


def test_a_blunder_is_named_beside_other_causes(faulty: Diagnosis) -> None:
    """Counts of the left wheel times four, and warm wheels: both are named, the blunder with certainty."""
    causes = {cause.effect: cause for cause in faulty.causes}
    assert faulty.causes[0].effect == "encoder_gross"
    assert causes["encoder_gross"].parameters["factor_left"].value == pytest.approx(0.25)
    assert causes["encoder_gross"].parameters["factor_right"].value == pytest.approx(1.0)
    assert "temperature_radius" in causes


def test_the_same_seed_gives_the_same_diagnosis(sound: Diagnosis) -> None:
    assert diagnose_in_full(rich_campaign(), plan=False).to_dict() == sound.to_dict()


def only(built: Campaign, *names: str) -> Campaign:
    """The campaign with no measurements but those named."""
    all_of_them = ("distance_m", "ref_x_m", "ref_y_m", "ref_theta_rad")
    numbers = {
        name: np.full_like(values, np.nan) if name in all_of_them and name not in names else values
        for name, values in built.runs.numbers.items()
    }
    columns = {k: v for k, v in built.logs.columns.items() if k not in ("counts_front", "steer_rad")}
    return replace(built, runs=replace(built.runs, numbers=numbers), logs=replace(built.logs, columns=columns))


@pytest.mark.parametrize("names", [("ref_x_m",), ("ref_y_m",), ()])
def test_nothing_to_compare_is_refused(names: tuple[str, ...]) -> None:
    """Half an end pose, or none, is no measurement: refused with what would be one."""
    with pytest.raises(RefusedError, match=r"distance_m|measured"):
        diagnose_in_full(only(rich_campaign(), *names), plan=False)


def plain(value: Any) -> bool:
    """Whether a value is of JSON's own types, no subclass of them."""
    if type(value) is dict:
        return all(type(key) is str and plain(one) for key, one in value.items())
    if type(value) in (list, tuple):
        return all(plain(one) for one in value)
    return value is None or type(value) in (str, int, float, bool)


@pytest.mark.parametrize("case", ["corridor", "crossed", "sound", "faulty"])
def test_a_diagnosis_is_json_with_the_fields_of_the_contract(case: str, request: pytest.FixtureRequest) -> None:
    """Every field is there with its type, and nothing that JSON cannot hold: no NaN, no infinity, no numpy."""
    document = request.getfixturevalue(case).to_dict()
    for name, kind in FIELDS.items():
        assert type(document[name]) is kind, name
    assert document["verdict"] in VERDICTS
    assert json.loads(json.dumps(document, allow_nan=False)) is not None
    assert [name for name, value in document.items() if not plain(value)] == []
    assert bool(document["fix"]["why"]) != document["recommended"]
    assert document["closure"].keys() >= CLOSURE
    assert document["where"].keys() >= {"channels", "covariates", "runs", "places"}
    for channel in document["where"]["channels"].values():
        assert channel.keys() >= {"rms", "floor"}
    for cause in document["causes"]:
        assert cause.keys() >= {"effect", "probability", "share", "parameters"}
        assert 0.0 <= cause["probability"] <= 1.0
        assert 0.0 <= cause["share"] <= 1.0
        for quantity in cause["parameters"].values():
            assert len(quantity["ci95"]) == 2
    for run in document["next_runs"]:
        assert run.keys() >= {"kind", "payload_kg", "speed_mps", "why"}
    probabilities = [cause["probability"] for cause in document["causes"]]
    assert probabilities == sorted(probabilities, reverse=True)


def test_causes_are_plain_json(crossed: Diagnosis) -> None:
    assert all(plain(cause) for cause in crossed.to_dict()["causes"])


@pytest.mark.parametrize(("aside_m", "expected"), [(0.0, VerdictKind.UNDECIDED), (0.2, VerdictKind.UNKNOWN)])
def test_a_gap_beyond_all_that_differs_between_runs_is_one_at_any_noise_level(
    aside_m: float, expected: VerdictKind
) -> None:
    """Ends scatter by twelve times what is stated, no run is repeated, and one route ends 0.2 m aside, or none does."""
    rng = np.random.default_rng(1)

    def scattered(run: Run, now: Motion) -> None:
        now.end_x_m, now.end_y_m, now.end_rad = 12.0 * rng.normal(0.0, (2e-3, 2e-3, 1e-3))
        now.end_y_m += aside_m * (run.kind == "route_left")

    runs = [
        Run([(length, sign * kappa) for length, kappa in pieces], kind=f"{kind}_{side}", front=False, speed_mps=speed)
        for speed in (0.3, 0.6)
        for _ in range(2)
        for pieces, kind in ((ROUTE, "route"), (SQUARE, "square"))
        for sign, side in ((1, "left"), (-1, "right"))
    ]
    for number, run in enumerate(runs, start=1):
        run.numbers = {"temperature_C": 15.0 + 7.3 * number % 11.0, "minutes_under_load": 37.0 * number % 61.0}
    made = campaign(runs, truth=scattered, vehicle=Vehicle(track_m=0.7, drive="differential"))
    verdict = diagnose_in_full(made, plan=False)
    assert not verdict.noise_level.supported
    assert (verdict.kind, verdict.causes) == (expected, ())
    assert "Drive one route several times" in verdict.sentence


@pytest.mark.parametrize("others_differ", [False, True])
def test_a_gap_with_one_mistyped_end_is_never_an_all_clear(others_differ: bool) -> None:
    """Ten runs, none driven twice; the track is off. The mistyped run is omitted where all others agree without it."""
    rng = np.random.default_rng(3)

    def truth(run: Run, now: Motion) -> None:
        now.track = 0.02
        now.end_x_m, now.end_y_m, now.end_rad = rng.normal(0.0, (2e-3, 2e-3, 1e-3))
        now.end_x_m += 0.5 * (run is runs[4]) + others_differ * rng.normal(0.0, 0.1)

    shapes = {"line": [(3.0, 0.0)], "left": [(2.0, 0.4)], "right": [(2.0, -0.4)], "s": [(1.5, 0.5), (1.5, -0.5)]}
    runs = [
        Run([((1.0 + 0.07 * n) * length, kappa) for length, kappa in pieces], kind=kind, front=False)
        for n, (kind, pieces) in enumerate([*shapes.items(), *shapes.items(), *shapes.items()][:10])
    ]
    made = campaign(runs, truth=truth, vehicle=Vehicle(track_m=0.7, drive="differential"))
    verdict = diagnose_in_full(made, plan=False)
    assert verdict.kind is not VerdictKind.NO_GAP
    assert ("Omitted" in verdict.sentence and "r004 (" in verdict.sentence) is not others_differ
    assert ("track_width" in [cause.effect for cause in verdict.causes]) is not others_differ
