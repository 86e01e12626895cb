"""Diagnosis against geometry on runs that neither has seen: ``python -m tests.real.against_geometry FOLDER``.

Both are made on half of the kinds of OptiOdom's recordings and applied to the others. Printed: root mean squares of the
end position there, and by how many standard errors the diagnosis' fix is better (+) or worse (-), run by run.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from calib.campaign.model import Campaign
from calib.coefficients.build import from_geometry
from calib.coefficients.file import CoefficientFile
from calib.errors import CalibError
from calib.gap.apply import applied_model
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import model_of, with_effects, with_sensor_of
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from calib.kinematics.estimate import estimate_geometry
from tests.real import recordings

#: worse by more standard errors than this is worse beyond noise
BEYOND = 2.0


def squares(file: CoefficientFile | None, campaign: Campaign) -> np.ndarray:
    """Squared errors of the end position in m^2 of each run under a coefficient file; None: the campaign's model."""
    if file is None:
        there = observations_of(campaign, into_windows=False)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "c.json"
            path.write_bytes(file.to_bytes())
            model, effects = model_of(path, campaign)
            there = observations_of(with_sensor_of(path, campaign), model, into_windows=False)
            there, _ = with_effects(there, effects)
    nominal = predict(there)
    left = residuals(nominal, nominal)
    return np.asarray((left[:, 1:3] ** 2).sum(axis=1))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--draws", type=int, default=10)
    given = parser.parse_args()
    campaign = recordings.optiodom_differential(given.folder)
    kinds = np.unique(campaign.runs.label("kind"))
    rng, worse = np.random.default_rng(0), 0
    sys.stdout.write("| half | runs there | nominal mm | geometry mm | diagnosis mm | recommended | better by, sd |\n")
    sys.stdout.write("|---|---|---|---|---|---|---|\n")
    for draw in range(given.draws):
        mine = np.isin(campaign.runs.label("kind"), rng.permutation(kinds)[: len(kinds) // 2])
        half, others = campaign.select(np.flatnonzero(mine)), campaign.select(np.flatnonzero(~mine))
        try:
            geometry = from_geometry(estimate_geometry(half), half, accept="a comparison")
            diagnosis = diagnose_in_full(half, plan=False)
        except CalibError as error:
            sys.stdout.write(f"| {draw} | {error} |\n")
            continue
        fix = applied_model(diagnosis, half) if diagnosis.causes else None
        nominal, by_geometry, by_fix = (squares(file, others) for file in (None, geometry, fix))
        gain = by_geometry - by_fix
        sd = float(gain.mean() / (gain.std(ddof=1) / np.sqrt(len(gain)))) if gain.any() else 0.0
        worse += sd < -BEYOND
        rms = (1e3 * float(np.sqrt(values.mean())) for values in (nominal, by_geometry, by_fix))
        said = "yes" if diagnosis.recommended else "no"
        sys.stdout.write(
            f"| {draw} | {len(gain)} | {' | '.join(f'{each:.1f}' for each in rms)} | {said} | {sd:+.1f} |\n"
        )
    sys.stdout.write(f"worse beyond noise: {worse} of {given.draws}\n")


if __name__ == "__main__":
    main()
