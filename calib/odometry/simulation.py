"""One simulation as the user asked for it: sweeps of radii, a law's journeys, the headline, and their document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.checks.design import SIDES
from calib.campaign.checks.measurements import off
from calib.documents import Result
from calib.errors import DRAWN_PIECES, DRAWS, BadInputError, refuse_more
from calib.odometry.law_journey import BANDS, Journey, TableRow, law_journey, law_table
from calib.odometry.law_path import AxleLaw, LawPath, Loading, law_path
from calib.odometry.paper import STUDIES, Case, Headline, Sweep, headlines, paper_headline, run_sweep
from calib.odometry.routes import Route, find_route
from calib.radius.law import RadiusLaw

if TYPE_CHECKING:
    from pandas import DataFrame

CUSTOM: Final = "custom"

#: wheel loads (left, right) of the studies' journeys: the extremes of Fig. 3
LOADS_N: Final = {
    "symmetric": ((1100.0, 1100.0),),
    "asymmetric": ((200.0, 900.0), (900.0, 200.0)),
    "corrected": ((200.0, 900.0), (900.0, 200.0), (1100.0, 1100.0)),
}

#: loads of Table 1
TABLE_LOADS_N: Final = tuple(100.0 * n for n in range(2, 12))

#: which error a figure shows
SHOWN: Final = {"fig12": "distance_m", "fig13": "lateral_m", "fig14": "global_x_m", "fig16": "global_x_m"}


@dataclass(frozen=True, slots=True, eq=False)
class LawPart:
    """What a fitted law says."""

    law: RadiusLaw
    table: tuple[TableRow, ...]  #: table 1 and the bands of Fig. 15
    journeys: tuple[Journey, ...]  #: journeys without and with correction, for each pair of loads and each band
    notes: tuple[str, ...]  #: what the reader should know
    #: the last route driven under the loads that change on the way, or else under the first pair of loads: errors and
    #: covariance all along
    path: LawPath


@dataclass(frozen=True, slots=True, eq=False)
class LawJourneys:
    """Journeys that are asked for under a law."""

    axle: AxleLaw  #: the law, and the track that it is driven with
    loads_N: Sequence[tuple[float, float]] = ()  #: loads (left, right) of the journeys, in place of the study's own
    reference_N: tuple[float, float] = (300.0, 300.0)  #: loads whose radii the uncorrected odometry uses
    loading: Loading | None = None  #: loads that change on the way; None: the first of `loads_N` all along
    draws: int = 20_000  #: draws of the Monte Carlo


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Simulation(Result):
    """A simulation: `sweeps` by the name of their figure, `headlines` by wheel, the law's part where one is given."""

    study: str
    title: str
    sweeps: dict[str, Sweep]
    headlines: tuple[Headline, ...]
    law: LawPart | None

    @property
    def table(self) -> DataFrame:
        """The end of every vehicle's drive as a table; SI units."""
        from pandas import DataFrame

        rows = [{"figure": name, **row} for name, sweep in self.sweeps.items() for row in sweep.ends()]
        return DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the simulation as plain values, the points along the routes aside: ``calib simulate --json``."""
        document: dict[str, object] = {
            "study": self.study,
            "title": self.title,
            "sweeps": [
                {"figure": name, "route": sweep.route.name, "track_m": sweep.track_m, "cases": sweep.ends()}
                for name, sweep in self.sweeps.items()
            ],
            "headline": [asdict(line) for line in self.headlines],
            "paper": asdict(paper_headline()) if self.headlines else None,
            "law": None,
        }
        if self.law is not None:
            document["law"] = {
                "table": [asdict(row) for row in self.law.table],
                "journeys": [asdict(journey) for journey in self.law.journeys],
                "path": self.law.path.document(),
                "notes": list(self.law.notes),
            }
        return document


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

    `track_m`, `real_track_m`: track that the odometry believes, and the real one (None: the same); `under`: adds Table
    1, Fig. 15 and journeys under a law. Raises BadInputError where the study, a route or a case cannot be used.
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
    return Simulation(
        study=study,
        title=known.title if known else "Radii as given",
        sweeps=sweeps,
        headlines=headlines(next(iter(sweeps.values())).route, track_m) if study == "corrected" and not cases else (),
        law=None if under is None else _law_part(study, find_route(names[-1]), under, rng),
    )


def _hold_radii(law: RadiusLaw, loads_N: Sequence[tuple[float, float]]) -> None:
    """Refuse loads so far from those measured that the law's radius is none of this wheel any more."""
    for pair in loads_N:
        for side, wheel, load in zip(SIDES, (law.left, law.right), pair, strict=True):
            radius = float(wheel.radius_m(load))
            if off(radius / float(wheel.radius_m(wheel.reference_load_N))):
                raise BadInputError(
                    f"load of the {side} wheel: found {load:g} N, where the law gives a radius of {radius:g} m; "
                    f"expected a load nearer to the {wheel.load_min_N:g} to {wheel.load_max_N:g} N where it holds"
                )


def _law_part(study: str, route: Route, under: LawJourneys, rng: np.random.Generator) -> LawPart:
    law, track_m, reference_N, draws = under.axle.radii, under.axle.track_m, under.reference_N, under.draws
    refuse_more("draws", draws, DRAWS, "the intervals no longer change")
    if draws < 100:
        raise BadInputError(f"draws: found {draws}; expected 100 or more; quantiles need them")
    own = tuple(dict.fromkeys(row[1:] for row in under.loading.rows)) if under.loading and study == CUSTOM else ()
    pairs = tuple(under.loads_N) or own or LOADS_N.get(study, LOADS_N["corrected"])
    # setting a journey up takes as long as some twenty pieces
    most = DRAWN_PIECES // (len(pairs) * (len(route) + 20))
    refuse_more(f"draws of {len(pairs)} journeys of {len(route)} pieces", draws, most, "ask for fewer of them")
    _hold_radii(law, [*pairs, reference_N])
    loading = under.loading or Loading.from_rows([(0.0, *pairs[0])])
    path = law_path(under.axle, route, loading=loading, reference_N=reference_N, draws=draws, rng=rng.spawn(1)[0])
    journeys = tuple(
        law_journey(law, route, loads_N=pair, reference_N=reference_N, track_m=track_m, band=band, draws=draws, rng=rng)
        for pair in pairs
        for band in BANDS
    )
    notes = []
    for side, wheel, number in (("left", law.left, 0), ("right", law.right, 1)):
        carried = (path.loading.left_N, path.loading.right_N)[number].tolist()
        loads = sorted({pair[number] for pair in pairs} | {reference_N[number], *carried})
        beyond = [load for load in loads if not wheel.load_min_N - 1.0 <= load <= wheel.load_max_N + 1.0]
        if beyond:
            notes.append(
                f"{side} wheel: {', '.join(f'{load:g}' for load in beyond)} N lie outside the "
                f"{wheel.load_min_N:g} to {wheel.load_max_N:g} N where the law holds: it extrapolates there"
            )
    return LawPart(
        law=law, table=law_table(law, np.array(TABLE_LOADS_N)), journeys=journeys, notes=tuple(notes), path=path
    )
