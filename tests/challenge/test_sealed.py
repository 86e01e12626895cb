"""Sealing, running and opening: what is promised about the order and about who sees what."""

from __future__ import annotations

import ast
import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.challenge import GROUPS, HASH, PUBLIC, Seeds, make, read_seeds, recipes, run, truth_path
from calib.challenge.cases import Truth
from calib.challenge.score import open_truth, score
from calib.documents import plain
from calib.errors import BadFileError, BadInputError
from calib.plant.effects import effects
from calib.reporting.figures import save
from calib.reporting.figures.studies import board_figure, confusion_figure

ROOT = Path(__file__).resolve().parents[2]
FULL = {
    "development": Path(__file__).parent / "seeds" / "development.toml",
    "scoring": Path(__file__).parent / "seeds" / "scoring.toml",
}
SMALL = """
format = "calib-challenge-seeds/1"
purpose = "test"
seed = 4
max_runs = 20
[cases]
empty = 1
single = 1
deleted = 1
"""


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("challenge")
    (folder / "seeds.toml").write_text(SMALL, encoding="utf-8")
    order: list[str] = []
    made = make(
        folder / "seeds.toml",
        folder / "set",
        workers=1,
        progress=lambda _done, _total, stage: order.append(stage),
        sealed=order.append,
    )
    # the hash stands before the first campaign is driven
    assert order.index(made.sha256) < order.index("campaigns")
    assert order.index(made.sha256) > len(order) - 1 - order[::-1].index("truths")
    return folder / "set"


def silent(_c: Campaign, _s: int, _x: tuple[str, ...], _f: Campaign | None) -> tuple[dict[str, Any], None]:
    return {"verdict": "no_gap", "causes": [], "credible_sets": [[]], "indistinguishable": []}, None


def test_the_truth_lies_apart_and_its_hash_is_in_the_set(sealed: Path) -> None:
    truth = truth_path(sealed)
    assert not truth.is_relative_to(sealed)
    digest = hashlib.sha256(truth.read_bytes()).hexdigest()
    assert (sealed / HASH).read_text(encoding="utf-8").split()[0] == digest
    assert json.loads((sealed / PUBLIC).read_text(encoding="utf-8"))["truth_sha256"] == digest


def test_no_file_of_a_campaign_names_the_effect(sealed: Path) -> None:
    """Neither effects nor groups, seeds, sizes or forms stand anywhere under cases and fresh."""
    words = {name.partition(":")[0] for name in effects()} | {"outside", "deleted", "signal", "truth", "seed"}
    words -= {"covariate"}
    for path in [*sealed.glob("cases/**/*"), *sealed.glob("fresh/**/*")]:
        if path.is_file() and path.suffix in {".toml", ".csv"}:
            head = path.read_text(encoding="utf-8")[:4000]
            assert not [word for word in words if word in head], path
    assert {path.name for path in (sealed / "cases").iterdir()} == {"c0001", "c0002", "c0003"}


def test_the_public_file_says_only_what_is_deleted(sealed: Path) -> None:
    public = json.loads((sealed / PUBLIC).read_text(encoding="utf-8"))
    assert set(public) == {"format", "purpose", "truth_sha256", "cases"}
    assert all(set(entry) == {"exclude"} for entry in public["cases"].values())


def test_the_fresh_campaign_is_the_same_design_under_other_noise(sealed: Path) -> None:
    one, two = (read_campaign(sealed / place / "c0001") for place in ("cases", "fresh"))
    assert list(one.runs.label("kind")) == list(two.runs.label("kind"))
    assert (one.runs.number("payload_kg") == two.runs.number("payload_kg")).all()
    assert (one.runs.number("counts_left") != two.runs.number("counts_left")).any()


def test_the_runner_resumes_and_never_needs_the_truth(sealed: Path, tmp_path: Path) -> None:
    hidden = truth_path(sealed).rename(tmp_path / "elsewhere.json")
    try:
        assert run(sealed, workers=1, limit=2, diagnoser=silent).done == 2
        again = run(sealed, workers=1, diagnoser=silent)
        assert (again.done, again.skipped) == (1, 2)
    finally:
        hidden.rename(truth_path(sealed))
    found = score(sealed)
    assert len(found.cases) == 3
    assert found.board["false alarms"].hits == 0
    for number, figure in enumerate((board_figure(found), confusion_figure(found))):
        for suffix in (".png", ".svg", ".pdf"):
            assert save(figure, tmp_path / f"{number}{suffix}").stat().st_size > 1000
    with pytest.raises(BadInputError, match="existing file"):
        save(board_figure(found), tmp_path / "0.png")
    json.dumps(found.to_dict(), allow_nan=False)


def test_a_diagnosis_that_falls_over_is_a_miss_not_an_end(sealed: Path, tmp_path: Path) -> None:
    def fall(_c: Campaign, _s: int, _x: tuple[str, ...], _f: Campaign | None) -> tuple[dict[str, Any], None]:
        raise ZeroDivisionError("by hand")

    kept = [path.rename(tmp_path / path.name) for path in (sealed / "verdicts").glob("*.json")]
    ran = run(sealed, workers=1, limit=1, diagnoser=fall)
    assert ran.failed == 1
    assert "by hand" in (sealed / "verdicts" / "c0001.json").read_text(encoding="utf-8")
    (sealed / "verdicts" / "c0001.json").unlink()
    for path in kept:
        path.rename(sealed / "verdicts" / path.name)


def test_a_truth_changed_after_sealing_is_refused(sealed: Path, tmp_path: Path) -> None:
    forged = tmp_path / "forged.json"
    forged.write_text(truth_path(sealed).read_text(encoding="utf-8").replace("plain", "other"), encoding="utf-8")
    with pytest.raises(BadFileError, match="changed after sealing"):
        open_truth(sealed, forged)


def test_the_same_seeds_seal_the_same_truth(sealed: Path, tmp_path: Path) -> None:
    seeds = tmp_path / "seeds.toml"
    seeds.write_text(SMALL, encoding="utf-8")
    made = make(seeds, tmp_path / "again", workers=1, limit=1)
    first = json.loads(made.truth.read_text(encoding="utf-8"))["cases"]["c0001"]
    assert first == json.loads(truth_path(sealed).read_text(encoding="utf-8"))["cases"]["c0001"]
    assert json.loads(json.dumps(plain(Truth.from_dict(first)))) == first


def test_a_set_is_not_overwritten_without_force(sealed: Path) -> None:
    with pytest.raises(BadInputError, match="force=True"):
        make(sealed.parent / "seeds.toml", sealed, workers=1)


def test_the_runner_uses_nothing_that_knows_the_truth() -> None:
    """Neither the runner nor what it calls in its module names the truth's file, or what makes or reads the truth."""
    tree = ast.parse((ROOT / "calib" / "challenge" / "__init__.py").read_text(encoding="utf-8"))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    origin = {
        alias.name: node.module
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
    names, open_functions = set[str](), {"run"}
    while open_functions:
        used = {node.id for node in ast.walk(functions[open_functions.pop()]) if isinstance(node, ast.Name)}
        open_functions |= (used & functions.keys()) - names
        names |= used
    assert {"_run_case", "achieved", "diagnose_in_full"} <= names
    assert not [name for name in names if "truth" in name.lower() or origin.get(name, "").startswith("calib.challenge")]


@pytest.mark.parametrize("name", FULL)
def test_the_full_sets_hold_what_a_sceptic_asks_for(name: str) -> None:
    """400 cases and more: 124 empty, every effect at every signal, pairs, outside, aliases, each effect deleted."""
    listed = recipes(read_seeds(FULL[name]))
    count = Counter(one.group for one in listed)
    assert len(listed) >= 400
    assert count["empty"] >= 124
    # these two sets were made before several causes at once were asked for; the set after them holds every group
    assert set(count) == set(GROUPS) - {"crowded"}
    inside = {effect for effect in effects() if not effect.startswith("outside:")}
    singles = {one.effects[0].partition("/")[0] for one in listed if one.group == "single"}
    calibration = {"radius_scale", "unequal_radii", "track_width"}
    missing = {effect for effect in inside - singles - calibration if not effect.startswith("covariate:")}
    assert not missing
    for signal in (3.0, 5.0, 10.0, 25.0):
        assert sum(one.targets[:1] == (signal,) for one in listed if one.group == "single") >= 30
    assert {one.deleted for one in listed if one.group == "deleted"} >= calibration
    assert {one.effects[0] for one in listed if one.group == "outside"} == {
        effect for effect in effects() if effect.startswith("outside:")
    }
    assert len({one.case for one in listed}) == len(listed)


def test_development_and_scoring_seeds_differ() -> None:
    seeds = {read_seeds(path).seed for path in (*FULL.values(), FULL["scoring"].with_name("ci.toml"))}
    assert len(seeds) == 3


def test_the_order_of_the_cases_says_nothing_about_their_group() -> None:
    listed = recipes(Seeds("test", 3, {"empty": 30, "single": 30}))
    first = [one.group for one in listed[:30]]
    assert 5 < first.count("empty") < 25  # shuffled: 15 expected, four standard deviations


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("nonsense [", "no valid TOML"),
        ('format = "calib-challenge-seeds/1"\nseed = "a"\n[cases]\n', "whole number"),
        ('format = "calib-challenge-seeds/1"\nseed = 1\n[cases]\nodd = 3\n', "cases.odd"),
        ('format = "calib-challenge-seeds/1"\nseed = 1\nmax_runs = 2\n[cases]\nempty = 3\n', "max_runs"),
    ],
)
def test_a_bad_seeds_file_is_named(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "seeds.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadFileError, match=match):
        read_seeds(path)


def test_the_next_set_to_score_holds_every_group() -> None:
    """Several causes at once beside one outside the library included."""
    count = Counter(recipe.group for recipe in recipes(read_seeds(Path(__file__).with_name("seeds") / "scoring8.toml")))
    assert set(count) == set(GROUPS)
