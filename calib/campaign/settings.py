"""What `campaign.toml` says: encoder, rangefinder, reference, odometry, and the model that the simulator believes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

from calib.vehicle import Vehicle

Frame = Literal["start", "map"]
OdometrySource = Literal["rear", "front", "wheels", "shaft"]
EncoderKind = Literal["counts", "speed"]

#: frames that the reference's poses may stand in
FRAMES: Final[tuple[str, ...]] = get_args(Frame)
#: what the logs say of the wheels
ENCODER_KINDS: Final[tuple[str, ...]] = get_args(EncoderKind)
#: sensors that may drive the vehicle's own odometry
ODOMETRY_SOURCES: Final[tuple[str, ...]] = get_args(OdometrySource)


#: way that a count stands for where the logs have speeds: far below what any reference can tell
SPEED_COUNT_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Encoder:
    """Encoders: counts per wheel revolution, and the counter's width where it wraps."""

    #: counts a revolution of the rear wheels
    counts_per_rev_left: float = 4096.0
    counts_per_rev_right: float = 4096.0
    #: width of the counter; None where it does not wrap or unspecified
    wrap_bits: int | None = None
    #: counts a revolution of the front wheel; None where the left wheel's value holds for it too
    counts_per_rev_front: float | None = None
    #: speed: the logs have speeds in m/s by the nominal radii; they are integrated to counts of `SPEED_COUNT_M`
    kind: EncoderKind = "counts"

    @property
    def front(self) -> float:
        """Counts a revolution of the front wheel, the left wheel's where it has none of its own."""
        return self.counts_per_rev_left if self.counts_per_rev_front is None else self.counts_per_rev_front


@dataclass(frozen=True, slots=True)
class FrontModel:
    """What the simulator believes of a steered vehicle; the true angle is scale times the sensor's, plus zero."""

    #: of the wheel that is counted: the front wheel, or with an Ackermann drive the rear wheels
    radius_m: float
    wheelbase_m: float
    zero_rad: float = 0.0
    scale: float = 1.0
    #: of an Ackermann drive in fast turns: curvature tan(angle) / (L (1 + understeer v^2)), slip angle
    #: -side_slip v^2 curvature
    understeer_s2_per_m2: float = 0.0
    side_slip_s2_per_m: float = 0.0

    @staticmethod
    def of(vehicle: Vehicle) -> FrontModel:
        """Return the nominal counted wheel and wheelbase of a vehicle."""
        radius_m = vehicle.wheel_radius_m if vehicle.drive == "ackermann" else vehicle.front_radius_m
        return FrontModel(radius_m, vehicle.wheelbase_m)


@dataclass(frozen=True, slots=True)
class MecanumModel:
    """What the simulator believes of four mecanum wheels: their radius, and half the length plus half the width."""

    radius_m: float
    arm_m: float


@dataclass(frozen=True, slots=True)
class OdometryModel:
    """What the simulator believes of the wheels: r = radius + slope (F - reference_load), and the track.

    `front` and `mecanum` are what it believes of a front wheel or of four wheels that alone drive the odometry; None
    where that is the nominal vehicle.
    """

    radius_left_m: float
    radius_right_m: float
    track_m: float
    reference_load_N: float
    slope_left_m_per_N: float = 0.0
    slope_right_m_per_N: float = 0.0
    front: FrontModel | None = None
    mecanum: MecanumModel | None = None


@dataclass(frozen=True, slots=True)
class Rangefinder:
    """Laser rangefinder: standard uncertainty of one distance, and the span of distances that it can measure."""

    sigma_m: float = 0.0015
    min_m: float = 0.05
    max_m: float = 250.0


@dataclass(frozen=True, slots=True)
class Reference:
    """Pose reference: its uncertainties, where its frame sits on the vehicle, and the frame its poses stand in."""

    #: standard uncertainties of position (each axis) and heading
    sigma_xy_m: float = 0.002
    sigma_theta_rad: float = 0.0008
    #: place of the reference's frame on the vehicle: ahead of the rear axle's middle, left of it, and turned
    #: counter-clockwise against the vehicle's heading
    sensor_x_m: float = 0.0
    sensor_y_m: float = 0.0
    sensor_yaw_rad: float = 0.0
    #: start: poses in each run's own start frame; map: in one frame common to all runs; None where unspecified
    frame: Frame | None = None


@dataclass(frozen=True, slots=True)
class Odometry:
    """What the vehicle's own odometry runs on."""

    #: rear: the two rear wheels' encoders; front: the front wheel's encoder and steering angle; wheels: all (mecanum);
    #: shaft: the way at the rear axle or drive shaft and the steering angle (Ackermann); None where unspecified.
    #: The key in the file is ``from``
    source: OdometrySource | None = None
