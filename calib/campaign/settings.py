"""What `campaign.toml` says: encoder, rangefinder, reference, and the model that the simulator believes."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Encoder", "OdometryModel", "Rangefinder", "Reference"]


@dataclass(frozen=True, slots=True)
class Encoder:
    """Rear-wheel encoders: counts per wheel revolution, and the counter's width where it wraps."""

    counts_per_rev_left: float = 4096.0
    counts_per_rev_right: float = 4096.0
    wrap_bits: int | None = None


@dataclass(frozen=True, slots=True)
class OdometryModel:
    """What the simulator believes of the wheels: r = radius + slope (F - reference_load), and the track."""

    radius_left_m: float
    radius_right_m: float
    track_m: float
    reference_load_N: float
    slope_left_m_per_N: float = 0.0
    slope_right_m_per_N: float = 0.0


@dataclass(frozen=True, slots=True)
class Rangefinder:
    """Laser rangefinder: standard uncertainty of one distance, and the span of distances that it can measure."""

    sigma_m: float = 0.0015
    min_m: float = 0.05
    max_m: float = 250.0


@dataclass(frozen=True, slots=True)
class Reference:
    """Pose reference: standard uncertainties of position (each axis) and heading."""

    sigma_xy_m: float = 0.002
    sigma_theta_rad: float = 0.0008
