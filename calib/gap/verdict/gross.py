"""A gross fault of the counts as a cause that a verdict names."""

from __future__ import annotations

from calib.gap.effects.encoder_gross import GrossFault
from calib.gap.verdict.result import Cause, Quantity

__all__ = ["gross_cause"]


def gross_cause(fault: GrossFault) -> Cause:
    """Return a gross fault as a cause: sure, the whole gap, its factors on the counts plain numbers."""
    return Cause(
        effect=fault.effect.id,
        title=fault.effect.title,
        form=fault.label,
        probability=1.0,
        share=1.0,
        signal=float("inf"),
        parameters={name: Quantity(factor, (factor, factor), "1") for name, factor in fault.factors.items()},
        remark=fault.remark,
        family=fault.effect.family.value,
    )
