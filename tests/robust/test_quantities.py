"""Numbers that become counts of samples, points, draws, runs or processes are held before anything is made of them."""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
import pytest

import calib.gap.plan as identifiability
from calib import errors
from calib.cli.main import overflow_noted, run
from calib.gap.observations.from_campaign import edges_along
from calib.gap.plan import outlook_of
from calib.gap.plan.next_runs import read_plan
from calib.gap.plan.planned_runs import stop_and_go
from tests.fuzz.sound import ROOT, SEEDS, small_campaign

#: processor time in which a number beyond its limit is refused, imports included; what it asks for takes minutes or
#: all memory
REFUSED_S = 5.0
#: a sum of doubles of up to a kilometre
ROUNDING_M = 1e-12
PLAN = (ROOT / "sample_runs" / "plan.toml").read_text(encoding="utf-8")
ROUTE = 'format = "calib-route/1"\n[[segment]]\n'
LAW = str(ROOT / "sample_runs" / "corridor")
#: name -> file written, its text, command on it (@), what is said
BEYOND: dict[str, tuple[str, str, str]] = {
    "runs of a plan": (
        PLAN.replace("count = 6", "count = 1001", 1),
        "plan --from @",
        "1001 runs; expected at most 1000",
    ),
    "runs to choose from": (
        '[[runs]]\nkind = "corridor"\ncount = 4000000000',
        f"plan {LAW} --candidates @",
        "4000000000 runs; expected at most 1000",
    ),
    "a long route": (ROUTE + "straight_m = 1e6", "simulate route @ --real 0.1,0.099", "1e+06 m at 0.05 m each: found"),
    "a wide arc": (ROUTE + "radius_m = 1e6\nturn_deg = 1e6", "simulate route @ --real 0.1,0.099", "at most 200000"),
    "turns on the spot": (
        ROUTE + "radius_m = 0\nturn_rad = 1e6",
        "simulate route @ --real 0.1,0.099",
        "found 19098594; expected at most 200000",
    ),
    "a journey": (
        ROUTE + "straight_m = 1e6",
        f"simulate journey @ --law {LAW} --load 400,400",
        "drive a shorter route",
    ),
    "many vehicles": (
        ROUTE + "straight_m = 9e3",
        "simulate route @ --ratio 0.99,1.0,1.01",
        "poses of 3 vehicles along route: found 540003; expected at most 500000",
    ),
    "draws": (
        "",
        f"simulate journey corridor --law {LAW} --load 400,400 --draws 1000000000000",
        "--draws: found 1000000000000; expected at most 1000000",
    ),
    "a sweep of loads": (
        "",
        f"loads --vehicle {LAW} --sweep payload --from 0 --to 100 --steps 1000000000000",
        "expected payload_kg, payload_x_m, payload_y_m in 2 to 10000 steps",
    ),
    "vehicles": ("", "fleet simulate --into F --vehicles 1000000000", "found 60000000000; expected at most 20000000"),
    "vehicles with poses": ("", "fleet simulate --poses --into F --vehicles 1000000000", "expected at most 20000000"),
    "months": ("", "fleet simulate --into F --vehicles 1 --months 1000000000", "--months: found 1000000000; expected"),
    "cases": (
        SEEDS.replace("empty = 1", "empty = 1000000000000"),
        "challenge make --seeds @ --into S",
        "1000000000000 cases; expected at most 100000",
    ),
    "processes": ("", f"fleet run {LAW} --into F --workers 1000000", "--workers: found 1000000; expected at most"),
    "processes of a check": (SEEDS, "challenge make --seeds @ --into S --workers 1000000", "--workers: found 1000000"),
}


@pytest.mark.parametrize("name", list(BEYOND))
def test_a_number_beyond_its_limit_is_one_line_and_quick(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything of that number is made: nothing is written, and no time or memory goes into it."""
    text, command, words = BEYOND[name]
    monkeypatch.chdir(tmp_path)
    Path("route.toml").write_text(text, encoding="utf-8")
    started = time.process_time()
    assert run(command.replace("@", "route.toml").split()) == 2
    assert time.process_time() - started < REFUSED_S
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["route.toml"]


def test_a_slow_run_is_logged_at_wider_steps() -> None:
    """A kilometre at 1 mm/s is 10^6 s; at a tenth of a second each that were 10^7 samples a run."""
    for speed in (1e-3, 0.5, 1e6):
        time_s, way_m = stop_and_go(np.linspace(0.0, 1000.0, 4), speed, read_rolling=False)
        # half a second at each of three ends adds its samples
        assert len(time_s) <= errors.PLANNED_SAMPLES + 20
        assert way_m[-1] == 1000.0
        assert (np.diff(time_s) > 0.0).all()
        assert (np.diff(way_m) > -ROUNDING_M).all()
    time_s, _ = stop_and_go(np.array([0.0, 40.0]), 0.5, read_rolling=False)
    # what is usual keeps its tenth of a second
    assert np.median(np.diff(time_s)) == pytest.approx(0.1)


def test_a_plan_makes_each_signature_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What each cause would do is computed in one pass: made a second time, a thousand runs took 13 s for 5 s."""
    asked: list[int] = []
    once = identifiability.signature_columns

    def counted(path, forms):  # type: ignore[no-untyped-def]
        asked.append(len(forms))
        return once(path, forms)

    monkeypatch.setattr(identifiability, "signature_columns", counted)
    # any other way to the columns of a form would be a second pass
    monkeypatch.setattr("calib.gap.inference.fit.signature_columns", None)
    path = tmp_path / "plan.toml"
    path.write_text(PLAN, encoding="utf-8")
    outlook = outlook_of(read_plan(path))
    assert len(asked) == 1
    assert asked[0] >= len(outlook.effects)
    assert set(outlook.smallest) == {*outlook.effects, *outlook.absent}


@pytest.mark.parametrize("way", [1e-9, 40.0, 1e15, np.inf])
def test_windows_are_no_more_than_samples(way: float) -> None:
    """Counts of 10^18 seem to go round the earth, in windows of 4 m."""
    samples = np.linspace(0.0, 1.0, 101) * min(way, 1e15)
    edges = edges_along(samples, way / 4.0)
    assert len(edges) <= len(samples)
    assert edges[0] == 0
    assert edges[-1] <= 100
    assert (np.diff(edges) > 0).all()


#: name -> command, what is said; each ended in exit status 3, or in a library's lines about its code
ABSURD: dict[str, tuple[str, str]] = {
    "a track of nothing": ("--load 400,400 --track 1e-300", "--track: found 1e-300 m; expected lengths from 0.0001"),
    "a load beyond all": ("--load 1e300,1e300", "load of the left wheel: found 1e+300 N, where the law gives a radius"),
    "a reference beyond all": ("--load 400,400 --reference-load 1,1e9", "load of the right wheel: found 1e+09 N"),
    "a thousand journeys": ("--load 400,400 " * 1000, "draws of 1000 journeys of 2 pieces: found 20000; expected"),
}


@pytest.mark.parametrize("name", list(ABSURD))
def test_an_absurd_journey_is_one_line(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    options, words = ABSURD[name]
    assert run(["simulate", "journey", "figure8", "--law", LAW, *options.split()]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("command", "factor", "words"),
    [
        ("geometry", 10**15, "found numbers that differ too much in size to compute with"),
        ("diagnose", 10**12, "run r000: found counts of a distance of"),
    ],
)
def test_counts_beyond_computing_are_one_line(
    command: str, factor: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Counts of 10^18 and more on one wheel: the other's part is lost in rounding, and no matrix can be solved."""
    log = small_campaign(tmp_path / "C") / "logs" / "r000.csv"
    header, *rows = log.read_text(encoding="utf-8").splitlines()
    beyond = [f"{t},{int(left) * factor},{right}" for t, left, right in (row.split(",") for row in rows)]
    log.write_text("\n".join([header, *beyond]) + "\n", encoding="utf-8")
    assert run([command, str(tmp_path / "C")]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1


def test_what_a_library_warns_of_is_one_note(capsys: pytest.CaptureFixture[str]) -> None:
    """Overflows of numpy are said without its code, once; other warnings are shown as they are."""
    with overflow_noted():
        for _ in range(3):
            np.float64(1e300) * np.float64(1e300)
    err = capsys.readouterr().err
    assert err == ("calib: note: some numbers are too large, too small or missing to compute with (overflow)\n")
    with pytest.warns(UserWarning, match="look here"), overflow_noted():
        warnings.warn("look here", UserWarning, stacklevel=1)
    assert not capsys.readouterr().err
