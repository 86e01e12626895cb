"""What the user of a geometry should know beside its numbers."""

from __future__ import annotations

from calib.geometry.clusters import Clustering
from calib.geometry.identifiability import NOMINAL_STD
from calib.geometry.recording import Recording


def notes_on(clustering: Clustering, recording: Recording, *, mean_held: bool, converged: bool) -> tuple[str, ...]:
    """Return notes in sentences.

    `clustering`: what was taken for independent; `recording`: says which runs could not be used; `mean_held`: whether
    the mean radius was held at its nominal value; `converged`: whether the search settled.
    """
    notes = []
    name, n = clustering.name, clustering.uncertainty.clusters
    if name in {"session", "route"}:
        notes.append(
            f"Runs of one {name} pull the parameters alike: the intervals take the {n} {name}s, not single runs, for "
            "independent. What they share is no noise; 'calib diagnose' looks for its cause."
        )
    if mean_held:
        notes.append(
            "These paths close, or nearly so, at any scale: the mean radius is not determined and was held at its "
            f"nominal value within {100 * NOMINAL_STD:g} %. The ratio of the radii and the track over the mean radius "
            "are determined; a straight run of known length would determine the scale."
        )
    if not converged:
        notes.append("The search did not settle to the last digit; the values are good to a small part of their sd.")
    if recording.left_out:
        first = recording.left_out[0]
        notes.append(f"Left out: {len(recording.left_out)} runs; the first, {first[0]}: {first[1]}.")
    return tuple(notes)
