"""Simulations: studies of the paper's Section 7, and vehicles that follow a route with wrong radii."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.checks import SIDES
from calib.campaign.checks.measurements import implausible_ratio
from calib.documents import Result, plain
from calib.errors import DRAWN_PIECES, DRAWS, SIMULATED_POSES, BadInputError, refuse_more
from calib.odometry.law_path import BANDS, AxleLaw, Journey, LawPath, law_journey, law_path
from calib.odometry.poses import COMPONENTS, POSE, PoseErrors, Poses, pose_errors
from calib.odometry.routes import SPACING_M, Axle, Loading, Route, find_route, follow
from calib.radius.law import RadiusLaw, round_loads
from calib.types import FloatArray, floats, rows_of

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, slots=True)
class Study:
    """A study by name."""

    title: str
    routes: tuple[str, ...]
    ratios: tuple[float, ...]
    which: tuple[str, ...]
    figures: tuple[str, ...]  #: of the paper, one a route


STUDIES: Final[Mapping[str, Study]] = {
    "symmetric": Study(
        "Both wheels roll at E times the radius that the odometry believes",
        ("paper_route",),
        (0.98, 0.98825, 0.98971, 0.99, 1.0),
        ("equal",),
        ("fig12",),
    ),
    "asymmetric": Study(
        "The radii differ by E_r = r_R / r_L, and the odometry believes that they do not",
        ("straight15", "paper_route"),
        (0.99, 0.995, 1.0, 1.005, 1.01),
        ("right", "left", "both"),
        ("fig13", "fig14"),
    ),
    "corrected": Study(
        "The radii follow the load; only the 95 % band of the regression",
        ("paper_route",),
        (0.9994, 0.9997, 1.0, 1.0003, 1.0006),
        ("right", "left", "both"),
        ("fig16",),
    ),
}


def ratios(which: str, ratio: float) -> tuple[float, float]:
    """Return left and right radius over the believed one, where E_r = r_R / r_L (``equal``: E) is `ratio`."""
    if not (math.isfinite(ratio) and ratio > 0.0):
        raise BadInputError(f"ratio of radii: found {ratio!r}; expected a number above 0, near 1")
    radii = {
        "right": (1.0, ratio),
        "left": (1.0 / ratio, 1.0),
        "both": (2.0 / (1.0 + ratio), 2.0 * ratio / (1.0 + ratio)),
        "equal": (ratio, ratio),
    }
    if which not in radii:
        raise BadInputError(f"which wheel: found {which!r}; expected one of {', '.join(radii)}; choose one of them")
    return radii[which]


@dataclass(frozen=True, slots=True)
class Case:
    """One vehicle of a sweep; radii over the believed ones."""

    which: str
    ratio: float
    left: float
    right: float

    @property
    def label(self) -> str:
        """Short name for tables and legends."""
        if self.which == "given":
            return f"given radii, E_r = {self.ratio:.6g}"
        if self.which == "equal":
            return f"both alike, E = {self.ratio:g}"
        return f"{self.which} off, E_r = {self.ratio:g}"

    @staticmethod
    def off(which: str, ratio: float) -> "Case":
        """Return the case of a wheel that is off by a ratio; see `ratios`."""
        return Case(which, ratio, *ratios(which, ratio))

    @staticmethod
    def given(left: float, right: float) -> "Case":
        """Return the case of radii (left, right) over the believed ones."""
        return Case("given", right / left, left, right)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Vehicles with different radii on one route."""

    route: Route
    track_m: float
    cases: tuple[Case, ...]
    distance_m: FloatArray  #: shape (n_points,): distance along the route at each point
    reference: Poses  #: route at the points, shape (n_points,)
    poses: Poses  #: real poses, shape (n_cases, n_points)
    errors: PoseErrors  #: real minus route, shape (n_cases, n_points)
    corners: Poses  #: real poses at the ends of the undivided segments, shape (n_cases, n_segments + 1)

    def ends(self) -> list[dict[str, str | float]]:
        """Return the numbers at the end of the route, one row a case."""
        columns = {"first_segment_m": np.hypot(self.corners.x_m[:, 1], self.corners.y_m[:, 1])}
        columns |= {f"end_{name}": getattr(self.poses, name)[:, -1] for name in POSE}
        columns |= {f"error_{name}": getattr(self.errors, name)[:, -1] for name in (*COMPONENTS, "distance_m")}
        rows = zip(self.cases, rows_of(columns), strict=True)
        return [{"case": case.label, "which": case.which, "ratio": case.ratio, **row} for case, row in rows]

    def along(self) -> list[dict[str, str | float]]:
        """Return poses and errors along the route, one row a case and point."""
        rows: list[dict[str, str | float]] = []
        for number, case in enumerate(self.cases):
            columns = {"distance_m": self.distance_m} | {name: getattr(self.poses, name)[number] for name in POSE}
            columns |= {f"error_{name}": getattr(self.errors, name)[number] for name in COMPONENTS}
            rows += [{"which": case.which, "ratio": case.ratio, **row} for row in rows_of(columns)]
        return rows


def run_sweep(route: Route | str, cases: Sequence[Case], *, track_m: float, real_track_m: float | None = None) -> Sweep:
    """Drive vehicles with different radii over a route, or one of that name; real track by default `track_m`."""
    way = find_route(route) if isinstance(route, str) else route
    believed, fine = Axle(1.0, 1.0, track_m), way.divided(SPACING_M)
    radii = ([case.left for case in cases], [case.right for case in cases])
    real = Axle(*radii, track_m if real_track_m is None else real_track_m)
    what = f"poses of {len(cases)} vehicles along {way.name}"
    refuse_more(what, len(cases) * (len(fine) + 1), SIMULATED_POSES, "simulate fewer vehicles, or a shorter route")
    reference, poses, corners = fine.poses(), follow(fine, believed, real), follow(way, believed, real)
    errors = pose_errors(poses, reference)
    return Sweep(way, track_m, tuple(cases), fine.distance_m(), reference, poses, errors, corners)


#: end error without and with the load correction, as printed (Sect. 7.3)
PAPER_BEFORE_M: Final = 1.1
PAPER_AFTER_M: Final = 0.06

PAPER_TRACK_M: Final = 0.7


@dataclass(frozen=True, slots=True)
class Improvement:
    """End errors without and with a correction, and their ratio; None where the corrected error is zero."""

    before_m: float
    after_m: float
    ratio: float | None


@dataclass(frozen=True, slots=True)
class Headline:
    """End error without and with the correction, each its sweep's largest, and their ratio."""

    which: str
    #: largest global e_x by absolute value
    without_m: float
    corrected_m: float
    ratio: float  #: how many times smaller the corrected one is


def headlines(route: Route, track_m: float) -> tuple[Headline, ...]:
    """Set the study of corrected radii against that of uncorrected ones, wheel by wheel."""
    lines = []
    for which in STUDIES["asymmetric"].which:
        sweeps = ([Case.off(which, ratio) for ratio in STUDIES[study].ratios] for study in ("asymmetric", "corrected"))
        ends = (np.abs(run_sweep(route, cases, track_m=track_m).errors.global_x_m[:, -1]).max() for cases in sweeps)
        before, after = map(float, ends)
        lines.append(Headline(which, before, after, before / after))
    return tuple(lines)


@cache
def paper_headline() -> Improvement:
    """Return the paper's end errors as printed, and their ratio before rounding."""
    largest = max(headlines(find_route("paper_route"), PAPER_TRACK_M), key=lambda line: line.without_m)
    return Improvement(PAPER_BEFORE_M, PAPER_AFTER_M, largest.ratio)


CUSTOM: Final = "custom"

#: wheel loads (left, right) of the studies' journeys: 0 the lowest, 1 the highest of Table 1
EXTREMES: Final = {"symmetric": ((1, 1),), "asymmetric": ((0, 1), (1, 0)), "corrected": ((0, 1), (1, 0), (1, 1))}

#: which error a figure shows
SHOWN: Final = {"fig12": "distance_m", "fig13": "lateral_m", "fig14": "global_x_m", "fig16": "global_x_m"}


@dataclass(frozen=True, slots=True)
class TableRow:
    """Radii at one load (Table 1), with 95 % half-widths of mean and single run (Fig. 15).

    `extrapolated_left`, `extrapolated_right`: beyond the wheel's law.
    """

    load_N: float
    radius_left_m: float
    radius_right_m: float
    mean_left_m: float
    mean_right_m: float
    prediction_left_m: float
    prediction_right_m: float
    extrapolated_left: bool
    extrapolated_right: bool


def law_table(law: RadiusLaw, loads_N: FloatArray) -> tuple[TableRow, ...]:
    """Return Table 1 for wheel loads (n,)."""
    loads = floats(loads_N)
    columns = []
    for wheel in (law.left, law.right):
        beyond = (loads < wheel.load_min_N) | (loads > wheel.load_max_N)
        bands = (wheel.half_width_m(loads, single_run=band == "prediction") for band in BANDS)
        columns.append([part.tolist() for part in (wheel.radius_m(loads), *bands, beyond)])
    pairs = [column for pair in zip(*columns, strict=True) for column in pair]
    return tuple(TableRow(*row) for row in zip(loads.tolist(), *pairs, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class LawPart:
    """What a fitted law says."""

    law: RadiusLaw = field(metadata={"json": False})
    table: tuple[TableRow, ...]  #: table 1 and the bands of Fig. 15
    journeys: tuple[Journey, ...]  #: without and with correction, for each pair of loads and each band
    path: LawPath  #: along the last route, under the loads that change on the way, or else the first pair
    notes: tuple[str, ...]
    simulated: bool  #: whether a program made the data of the law


@dataclass(frozen=True, slots=True, eq=False)
class LawJourneys:
    """Journeys that are asked for under a law."""

    axle: AxleLaw  #: the law, and the track that it is driven with
    loads_N: Sequence[tuple[float, float]] = ()  #: (left, right) of the journeys, in place of the study's
    #: of the uncorrected odometry; None: the reference load, or the nearest valid one
    reference_N: tuple[float, float] | None = None
    loading: Loading | None = None  #: changes on the way; None: the first of `loads_N` all along
    draws: int = 20_000


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Simulation(Result):
    """A simulation: `sweeps` by their figure, `headlines` by wheel, the law's part where one is given."""

    study: str
    title: str
    sweeps: dict[str, Sweep]
    headlines: tuple[Headline, ...]
    law: LawPart | None

    @property
    def simulated(self) -> bool:
        """Whether the law comes from simulated data."""
        return self.law is not None and self.law.simulated

    @property
    def table(self) -> "DataFrame":
        """The end of every vehicle's drive as a table; SI units."""
        from pandas import DataFrame

        return DataFrame([{"figure": name, **row} for name, sweep in self.sweeps.items() for row in sweep.ends()])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as ``calib simulate --json``, without points along the routes."""
        return {
            "study": self.study,
            "title": self.title,
            "sweeps": [
                {"figure": name, "route": sweep.route.name, "track_m": sweep.track_m, "cases": sweep.ends()}
                for name, sweep in self.sweeps.items()
            ],
            "headline": plain(self.headlines),
            "paper": plain(paper_headline()) if self.headlines else None,
            "law": plain(self.law),
        }


def simulate(
    study: str,
    *,
    routes: Sequence[str] = (),
    cases: Sequence[Case] = (),
    track_m: float,
    real_track_m: float | None = None,
    under: LawJourneys | None = None,
    rng: np.random.Generator,
) -> Simulation:
    """Run a study of `STUDIES` by name, or ``custom`` with routes and cases of one's own; see `Simulation`.

    `real_track_m`: None: as believed; `under`: adds Table 1, Fig. 15 and journeys under a law. Raises BadInputError
    where the study, a route or a case cannot be used.
    """
    known = STUDIES.get(study)
    if known is None and study != CUSTOM:
        raise BadInputError(f"study: found {study!r}; expected {', '.join(STUDIES)} or {CUSTOM}; choose one of them")
    names = tuple(routes) or (known.routes if known else ("paper_route",))
    usual = [Case.off(which, ratio) for which in known.which for ratio in known.ratios] if known else []
    chosen = tuple(cases) or tuple(usual)
    if not chosen and under is None:
        raise BadInputError("custom study: found no radii; expected cases or a law; give one of them")
    figures = known.figures if known and not routes else tuple(f"route{k + 1}" for k in range(len(names)))
    sweeps = {
        figure: run_sweep(name, chosen or (Case.given(1.0, 1.0),), track_m=track_m, real_track_m=real_track_m)
        for figure, name in zip(figures, names, strict=True)
    }
    first, title = next(iter(sweeps.values())).route, known.title if known else "Radii as given"
    lines = headlines(first, track_m) if study == "corrected" and not cases else ()
    law = None if under is None else _law_part(study, find_route(names[-1]), under, rng)
    return Simulation(study, title, sweeps, lines, law)


def _law_part(study: str, route: Route, under: LawJourneys, rng: np.random.Generator) -> LawPart:
    law, track_m, draws = under.axle.radii, under.axle.track_m, under.draws
    wheels = (law.left, law.right)
    left_N, right_N = (float(np.clip(w.reference_load_N, w.load_min_N, w.load_max_N)) for w in wheels)
    reference_N = under.reference_N or (left_N, right_N)
    refuse_more("draws", draws, DRAWS, "the intervals no longer change")
    if draws < 100:
        raise BadInputError(f"draws: found {draws}; expected 100 or more; quantiles need them")
    own = tuple(dict.fromkeys(row[1:] for row in under.loading.rows)) if under.loading and study == CUSTOM else ()
    ends = [round_loads(wheel.load_min_N, wheel.load_max_N)[[0, -1]].tolist() for wheel in wheels]
    usual = [(ends[0][left], ends[1][right]) for left, right in EXTREMES.get(study, EXTREMES["corrected"])]
    pairs = tuple(under.loads_N) or own or tuple(usual)
    # setting a journey up takes as long as some twenty pieces
    most = DRAWN_PIECES // (len(pairs) * (len(route) + 20))
    refuse_more(f"draws of {len(pairs)} journeys of {len(route)} pieces", draws, most, "ask for fewer of them")
    for pair in (*pairs, reference_N):
        for side, wheel, load in zip(SIDES, wheels, pair, strict=True):
            radius = float(wheel.radius_m(load))
            if implausible_ratio(radius / float(wheel.radius_m(wheel.reference_load_N))):
                raise BadInputError(
                    f"load of the {side} wheel: found {load:g} N, where the law gives a radius of {radius:g} m; "
                    f"expected a load nearer to the {wheel.load_min_N:g} to {wheel.load_max_N:g} N where it holds"
                )
    loading = under.loading or Loading.from_rows([(0.0, *pairs[0])])
    path = law_path(under.axle, route, loading=loading, reference_N=reference_N, draws=draws, rng=rng.spawn(1)[0])
    journeys = tuple(
        law_journey(law, route, loads_N=pair, reference_N=reference_N, track_m=track_m, band=band, draws=draws, rng=rng)
        for pair in pairs
        for band in BANDS[: 1 + law.scatters]
    )
    unknown = "scatter of single runs was not estimated: no ± of a run, and intervals without it"
    notes = [] if law.scatters else [unknown]
    carried = [reference_N, *pairs, *zip(path.loading.left_N.tolist(), path.loading.right_N.tolist(), strict=True)]
    for side, wheel, loads in zip(SIDES, wheels, map(set, zip(*carried, strict=True)), strict=True):
        beyond = [load for load in sorted(loads) if not wheel.load_min_N - 1.0 <= load <= wheel.load_max_N + 1.0]
        if beyond:
            notes.append(
                f"{side} wheel: {', '.join(f'{load:g}' for load in beyond)} N lie outside the "
                f"{wheel.load_min_N:g} to {wheel.load_max_N:g} N where the law holds: it extrapolates there"
            )
    every = round_loads(min(wheel.load_min_N for wheel in wheels), max(wheel.load_max_N for wheel in wheels))
    return LawPart(law, law_table(law, every), journeys, path, tuple(notes), under.axle.simulated)
