"""Every function of the API answers arguments of a wrong type with `CalibError`, and takes what means the same."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import calib
from calib.api.results import bind, checked
from calib.errors import BadInputError, CalibError

#: values that no argument of a kind is meant to be; every function gets each of them in each place
STRANGE: tuple[Any, ...] = (3.5, -1, object(), [], {}, [1, 2], b"x", [(1, 2, 3)], [None])


@pytest.fixture(scope="module")
def corridor(project_root: Path) -> calib.Campaign:
    return calib.read(project_root / "sample_runs" / "corridor_crossed")


def _calls(corridor: calib.Campaign, fit: calib.Fit, tmp_path: Path) -> dict[str, tuple[Any, ...]]:
    return {
        "read": (corridor.root,),
        "describe": ([corridor.root],),
        "ingest": ([corridor.root], tmp_path / "made"),
        "fit": (corridor,),
        "geometry": (corridor,),
        "diagnose": (corridor,),
        "plan": (corridor,),
        "simulate": (),
        "replay": (corridor, fit),
        "report": (fit, tmp_path / "report.pdf"),
        "export": (fit,),
    }


def test_strange_arguments_are_answered_by_one_family_of_errors(corridor: calib.Campaign, tmp_path: Path) -> None:
    """Never a TypeError or an AttributeError of what lies within; a value that fits is left to the function."""
    tried = refused = 0
    for name, args in _calls(corridor, calib.fit(corridor), tmp_path).items():
        function = inspect.unwrap(getattr(calib, name))
        for at, parameter in enumerate(inspect.signature(function).parameters):
            for value in STRANGE:
                given = [*args[:at], value, *args[at + 1 :]] if at < len(args) else list(args)
                tried += 1
                try:
                    bind(function, given, {} if at < len(args) else {parameter: value})
                except CalibError:
                    refused += 1
    assert tried > 300
    assert refused > 0.8 * tried


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda c: calib.fit(3), "fit: campaign: found 3 (int); expected a Campaign or a path or a text"),
        (lambda c: calib.fit("no such folder"), "no such folder"),
        (lambda c: calib.export(c, to=["ros2"]), "export: to: found ['ros2'] (list); expected a text"),
        (lambda c: calib.export(c, "csv", loads=[None]), "export: loads: found [None]"),
        (lambda c: calib.report(c, 7), "report: target: found 7 (int); expected a path or a text"),
        (lambda c: calib.diagnose(c, seed=-1), "seed: found -1"),
        (lambda c: calib.geometry(c, using="pictures"), "expected one of end_poses, windows or None"),
        (lambda c: calib.simulate(routes=[3]), "simulate: routes: found [3]"),
        (lambda c: calib.export(calib.geometry(c)), "give campaign=..."),
        (lambda c: c.log("r9999"), "found 'r9999'"),
        (lambda c: c.log(["r000", "r001"]), "found ['r000', 'r001']"),
        (lambda c: calib.describe([]), "sources: found none"),
        (lambda c: calib.describe(3), "expected a path or a text or a list, each a path or a text"),
        (lambda c: calib.ingest([], "made"), "sources: found none"),
        (lambda c: calib.ingest("a\0b", "made"), "expected a path or a text"),
        (lambda c: calib.read("a" * 5000), "aaa: found File name too long"),
        (lambda c: calib.fit(c).plot(["runs"]), "found the kind ['runs']; expected one of regressions"),
        (lambda c: calib.geometry(c)["track"], "track: found no estimate; expected one of radius_left_m"),
        (lambda c: calib.geometry(c).ratio("track_m", "radius"), "radius: found no estimate"),
    ],
)
def test_a_wrong_argument_is_said_by_name(call: Callable[[calib.Campaign], Any], words: str, corridor: Any) -> None:
    with pytest.raises(CalibError, match=re.escape(words)):
        call(corridor)


def test_what_means_the_same_is_taken(corridor: calib.Campaign) -> None:
    """Folders for campaigns, numbers of numpy, lists for tuples."""
    assert corridor.root is not None
    assert calib.fit(str(corridor.root)).to_dict() == calib.fit(corridor).to_dict()
    assert calib.export(corridor.root, "csv", loads=[np.float64(600.0), "500,700"]) == calib.export(
        calib.fit(corridor), "csv", loads=["600.0", "500,700"]
    )
    assert calib.simulate(seed=np.int64(3)).to_dict() == calib.simulate(seed=3).to_dict()


def test_annotations_of_every_kind_are_held() -> None:
    @checked
    def told(
        choice: Literal["a", "b"], pairs: Sequence[tuple[float, float]] = (), place: Path | str = "", flag: bool = False
    ) -> tuple[Any, ...]:
        return choice, pairs, place, flag

    assert told("a", [[1, 2]], Path("x"), True) == ("a", ((1.0, 2.0),), Path("x"), True)
    for wrong in (("c",), ("a", [(1, 2, 3)]), ("a", "12"), ("a", (), 3), ("a", (), "x", 1), ("a", {1: 2})):
        with pytest.raises(BadInputError):
            told(*wrong)


def test_logs_and_geometries_are_tables(corridor: calib.Campaign) -> None:
    """As many rows as samples, and as parameters; the same numbers."""
    run_id = str(corridor.runs.run_id[0])
    log = corridor.log(run_id)
    assert len(log) == corridor.logs.lengths[0]
    np.testing.assert_array_equal(log["counts_left"], corridor.logs.of(0)["counts_left"])
    estimated = calib.geometry(corridor)
    assert list(estimated.table.index) == [one.name for one in estimated.estimates]
    assert estimated.table.loc["track_m", "value"] == estimated["track_m"].value


def test_a_call_that_does_not_fit_names_the_function() -> None:
    with pytest.raises(TypeError, match=r"fit: .*'campaign'"):
        calib.fit()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"fit: .*'foo'"):
        calib.fit("c", foo=1)  # type: ignore[call-arg]


def test_what_the_command_line_refuses_is_refused(corridor: calib.Campaign) -> None:
    with pytest.raises(BadInputError, match="most: found 0"):
        calib.plan(corridor, most=0)
    with pytest.raises(BadInputError, match="workers: found 0"):
        calib.diagnose(corridor, workers=0)
    assert "c_effects" in str(calib.export.__doc__)
