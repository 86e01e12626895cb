"""What an export can be asked for beside its format."""

from __future__ import annotations

from dataclasses import dataclass

from calib.coefficients.loads import LoadPair

__all__ = ["ExportOptions"]


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Choices of an export; a format passes over those that it has no use for.

    Parameters
    ----------
    loads : tuple of LoadPair
        Load points, for formats that hold for single loads; none: the format's own choice.
    controllers : tuple of str
        Names of ROS 2 controllers; none: those of the vehicle's drive.
    position_feedback : bool
        Whether the wheels' joints report positions; False: velocities.
    open_loop : bool
        Whether the controllers integrate commands in place of what the encoders say.
    """

    loads: tuple[LoadPair, ...] = ()
    controllers: tuple[str, ...] = ()
    position_feedback: bool = True
    open_loop: bool = False

    @property
    def has_controller_choices(self) -> bool:
        """Whether something was chosen that only controllers have."""
        return bool(self.controllers) or not self.position_feedback or self.open_loop
