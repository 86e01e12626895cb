"""From a diagnosis to what its page shows: channels, gap before and after, covariates, and the floor plan."""

from __future__ import annotations

import numpy as np

from calib.gap.data.channels import Channel
from calib.gap.diagnosis import Diagnosis
from calib.gap.predict.residuals import residuals
from calib.gap.verdict.paper_headline import headline
from calib.gap.where.covariates import covariate_values
from calib.report.gap_findings import GapFindings


def findings_of(diagnosis: Diagnosis) -> GapFindings:
    """Return what a report shows of a diagnosis.

    Residuals of channels that a unit lacks are NaN; paths are those of the model alone, each from its own start.
    """
    observations, nominal, held_out = diagnosis.observations, diagnosis.nominal, diagnosis.held_out
    plain = np.where(observations.usable, residuals(nominal, nominal), np.nan)
    c, sn = np.cos(nominal.frame), np.sin(nominal.frame)
    along, lateral = plain[:, 1], plain[:, 2]
    offset = np.column_stack((c * along - sn * lateral, sn * along + c * lateral))
    paths = tuple(
        np.vstack(
            (
                np.zeros((1, 2)),
                np.column_stack((nominal.x_m[first:last], nominal.y_m[first:last])),
                nominal.end[unit, :2],
            )
        )
        for unit, (first, last) in enumerate(zip(observations.starts[:-1], observations.starts[1:], strict=True))
    )
    covariates = {
        name: np.asarray(values, dtype=np.float64)
        for name, values in covariate_values(observations).items()
        if values.dtype.kind == "f"
    }
    return GapFindings(
        verdict=diagnosis.verdict,
        headline=headline(diagnosis.verdict),
        channels=tuple((channel.label, channel.unit) for channel in Channel),
        before=np.where(observations.usable, held_out.before, np.nan),
        after=np.where(observations.usable, held_out.after, np.nan),
        floor=np.where(observations.usable, held_out.floor, np.nan),
        group=observations.labels["kind"],
        covariates=covariates,
        paths_m=paths if np.isfinite(offset).any() else (),
        offset_m=offset if np.isfinite(offset).any() else None,
    )
