"""Diagnosis against geometry on runs that neither has seen: ``python -m tests.real.against_geometry FOLDER``.

Both are made on half of the kinds of OptiOdom's recordings and applied to the others. Printed: root mean squares of the
end position there, and by how many standard errors the diagnosis' fix is better (+) or worse (-), run by run and kind
by kind. Judged is kind by kind: one correction moves all runs of a kind alike, so that its repeats are no further
evidence, and the kinds are what was drawn.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from calib.campaign.model import Campaign
from calib.coefficients.build import from_geometry
from calib.coefficients.file import CoefficientFile
from calib.errors import CalibError
from calib.gap.apply import applied_model
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import model_of, with_effects, with_mounting_of
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from calib.kinematics.estimate import estimate_geometry
from tests.real import recordings

#: chance of worse beyond noise where nothing is worse
CHANCE = 0.025


def squares(file: CoefficientFile | None, campaign: Campaign) -> np.ndarray:
    """Squared errors of the end position in m^2 of each run under a coefficient file; None: the campaign's model."""
    if file is None:
        there = observations_of(campaign, into_windows=False)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "c.json"
            path.write_bytes(file.to_bytes())
            model, effects = model_of(path, campaign)
            there = observations_of(with_mounting_of(path, campaign)[0], model, into_windows=False)
            there, _ = with_effects(there, effects)
    nominal = predict(there)
    left = residuals(nominal, nominal)
    return np.asarray((left[:, 1:3] ** 2).sum(axis=1))


def standard_errors(gains: np.ndarray) -> float:
    """Return a mean in its standard errors; 0 where nothing differs."""
    return float(gains.mean() / (gains.std(ddof=1) / np.sqrt(len(gains)))) if gains.any() else 0.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--halves", type=int, default=35, help="how many of the 35 halves")
    given = parser.parse_args()
    campaign = recordings.optiodom_differential(given.folder)
    kinds = np.unique(campaign.runs.label("kind"))
    halves, worse, judged = [*combinations(kinds, len(kinds) // 2)], 0, []
    heads = "made on", "runs there", "nominal mm", "geometry mm", "diagnosis mm", "recommended", "by runs", "by kinds"
    sys.stdout.write(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|\n")
    for some in halves[:: max(len(halves) // given.halves, 1)]:
        mine = np.isin(campaign.runs.label("kind"), some)
        half, others = campaign.select(np.flatnonzero(mine)), campaign.select(np.flatnonzero(~mine))
        try:
            geometry = from_geometry(estimate_geometry(half), half, accept="a comparison")
            diagnosis = diagnose_in_full(half, plan=False)
        except CalibError as error:
            sys.stdout.write(f"| {', '.join(some)} | {error} |\n")
            continue
        fix = applied_model(diagnosis, half) if diagnosis.causes else None
        nominal, by_geometry, by_fix = (squares(file, others) for file in (None, geometry, fix))
        gains, kind = by_geometry - by_fix, others.runs.label("kind")
        by_kind = np.array([gains[kind == each].mean() for each in np.unique(kind)])
        worse += (by_kinds := standard_errors(by_kind)) < stdtrit(len(by_kind) - 1, CHANCE)
        rms = [1e3 * float(np.sqrt(values.mean())) for values in (nominal, by_geometry, by_fix)]
        judged.append([*rms, diagnosis.recommended])
        said = "yes" if diagnosis.recommended else "no"
        sys.stdout.write(
            f"| {', '.join(some)} | {len(gains)} | {' | '.join(f'{each:.1f}' for each in rms)} | {said} "
            f"| {standard_errors(gains):+.1f} | {by_kinds:+.1f} |\n"
        )
    table = np.array(judged)
    for words, rows in (("all", table), ("recommended", table[table[:, 3] == 1.0])):
        medians = " | ".join(f"{each:.1f}" for each in np.median(rows[:, :3], axis=0))
        sys.stdout.write(f"median of {words} ({len(rows)}): {medians}\n")
    sys.stdout.write(f"worse beyond noise, kind by kind: {worse} of {len(judged)}\n")


if __name__ == "__main__":
    main()
