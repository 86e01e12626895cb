"""What is so gross that it is found, and put right, before the search, as a cause that a verdict names."""

from __future__ import annotations

from calib.gap.effects.encoder_gross import GrossFault
from calib.gap.effects.turned_reference import TurnedReference
from calib.gap.verdict.result import Cause, Quantity


def gross_cause(fault: GrossFault | TurnedReference) -> Cause:
    """Return a gross fault as a cause: sure, and the whole gap."""
    return Cause(
        effect=fault.effect.id,
        title=fault.effect.title,
        form=fault.label,
        probability=1.0,
        share=1.0,
        signal=float("inf"),
        parameters={name: Quantity(*size) for name, size in fault.sizes.items()},
        remark=fault.remark,
        family=fault.effect.family.value,
    )
