"""The effects that a campaign can be judged by, each with where it comes from and what it leaves on given runs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from calib.errors import BadInputError
from calib.gap.data.channels import Channel
from calib.gap.effects.covariate import Covariate
from calib.gap.effects.effect import Effect
from calib.gap.effects.library import REGISTRY, every_effect
from calib.gap.effects.signatures import EffectSignature, signature_of
from calib.gap.effects.user import Declared, entry_point_origins
from calib.gap.predict.path import Path

#: origin of the registered effects
LIBRARY: Final = "the library"


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """An effect of the catalogue."""

    effect: Effect  #: the cause
    #: where it comes from: the library, a column of the run table, ``campaign.toml``, or an installed package
    origin: str
    signature: EffectSignature | None  #: what it leaves on the runs at its typical size; None where they cannot show it
    #: shape (n_channels,): root mean square change of each channel by kind of run, NaN where a kind lacks the channel
    changes: Mapping[str, np.ndarray[tuple[int], np.dtype[np.float64]]]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain JSON values; sizes in SI units."""
        form = None if self.signature is None else self.signature.form
        return {
            "id": self.effect.id,
            "title": self.effect.title,
            "origin": self.origin,
            "family": str(self.effect.family),
            "needs": self.effect.needs,
            "separates": self.effect.separates,
            "implausible": self.effect.implausible,
            "shows": form is not None,
            "form": "" if form is None else form.label,
            "parameters": []
            if form is None
            else [
                {
                    "name": parameter.name,
                    "unit": parameter.unit,
                    "typical": parameter.typical,
                    "largest": parameter.largest,
                    "sign": parameter.sign,
                }
                for parameter in form.parameters
            ],
            "signature": {
                kind: {channel.label: float(rms[channel]) for channel in Channel if np.isfinite(rms[channel])}
                for kind, rms in self.changes.items()
            },
        }


def catalogue(nominal: Path, declared: object = (), only: Collection[str] = ()) -> list[Entry]:
    """Return the effects that runs can be judged by, those of the ids `only` or all.

    The library's own come first, then columns of the run table, then declared effects, then those of installed
    packages.
    """
    every = every_effect(nominal.s, declared=declared)
    for name in only:
        if name not in every:
            raise BadInputError(f"found the effect {name!r}; expected one of: {', '.join(every)}")
    offered = entry_point_origins()
    entries = []
    for name, effect in every.items():
        if not only or name in only:
            signature = signature_of(effect, nominal)
            changes = {} if signature is None else kind_changes(signature, nominal)
            entries.append(Entry(effect, _origin(effect, offered), signature, changes))
    return entries


def kind_changes(signature: EffectSignature, nominal: Path) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return the root mean square change of each channel, shape (n_channels,), by kind of run."""
    kinds = nominal.s.labels["kind"]
    changes = {}
    for kind in np.unique(kinds):
        square = signature.change[kinds == kind] ** 2
        known = np.isfinite(square)
        mean = np.where(known, square, 0.0).sum(axis=0) / np.where(known.any(axis=0), known.sum(axis=0), np.nan)
        changes[str(kind)] = np.sqrt(mean)
    return changes


def _origin(effect: Effect, offered: Mapping[str, str]) -> str:
    if effect.id in REGISTRY:
        return LIBRARY
    if isinstance(effect, Covariate):
        return f"the column {effect.column} of runs.csv"
    if isinstance(effect, Declared):
        return "[[effects]] of campaign.toml"
    return offered.get(effect.id, "an installed package")
