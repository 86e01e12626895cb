"""The settings of drive, sensor place, frame and odometry source: read in any unit, refused where they cannot be."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from calib.campaign.model import Campaign
from calib.campaign.settings_file import parse_settings, read_settings
from calib.errors import BadFileError

PLAIN = {"vehicle": {"track_m": 0.7, "wheel_radius_m": 0.1}, "encoder": {"counts_per_rev": 4096}}
ROUNDING = 1e-15  # relative, one multiplication in double precision


def parsed(**sections: dict[str, object]) -> Campaign:
    merged = {name: {**PLAIN.get(name, {}), **sections.get(name, {})} for name in {*PLAIN, *sections}}
    return parse_settings({"format": "calib-campaign/1", **merged}, "campaign.toml", "made")


def test_without_the_keys_nothing_is_assumed_beyond_the_plain_vehicle() -> None:
    """A file that says nothing of them has a tricycle, no frame and no source, and the sensor on the axle."""
    settings = parsed()
    assert settings.vehicle.drive == "tricycle"
    assert (settings.reference.frame, settings.odometry.source) == (None, None)
    assert (settings.reference.sensor_x_m, settings.reference.sensor_y_m, settings.reference.sensor_yaw_rad) == (
        0,
        0,
        0,
    )
    assert (settings.vehicle.front_radius_m, settings.encoder.front) == (0.1, 4096.0)
    assert not settings.notes


def test_every_key_is_read_and_none_is_said_to_be_unknown() -> None:
    settings = parsed(
        vehicle={"drive": "tricycle", "front_wheel_radius_m": 0.12},
        encoder={"counts_per_rev_front": 1600},
        reference={"sensor_x_m": 0.4, "sensor_y_m": -0.1, "sensor_yaw_rad": math.pi, "frame": "map"},
        odometry={"from": "front"},
    )
    assert (settings.vehicle.front_radius_m, settings.encoder.front) == (0.12, 1600.0)
    assert (settings.reference.frame, settings.odometry.source) == ("map", "front")
    assert settings.reference.sensor_yaw_rad == math.pi
    assert not settings.notes
    assert not settings.extra


def test_units_in_the_keys_are_converted() -> None:
    settings = parsed(
        vehicle={"drive": "mecanum", "half_length_plus_half_width_mm": 369},
        reference={"sensor_x_mm": -250, "sensor_yaw_deg": 180},
    )
    assert settings.vehicle.half_length_plus_half_width_m == pytest.approx(0.369, rel=ROUNDING)
    assert settings.reference.sensor_x_m == pytest.approx(-0.25, rel=ROUNDING)
    assert settings.reference.sensor_yaw_rad == pytest.approx(math.pi, rel=ROUNDING)


@pytest.mark.parametrize(
    ("sections", "column"),
    [
        ({"vehicle": {"drive": "unicycle"}}, "vehicle.drive"),
        ({"vehicle": {"drive": 3}}, "vehicle.drive"),
        ({"vehicle": {"front_wheel_radius_m": 0.0}}, "vehicle.front_wheel_radius_m"),
        ({"vehicle": {"half_length_plus_half_width_m": -0.3}}, "vehicle.half_length_plus_half_width_m"),
        ({"encoder": {"counts_per_rev_front": 0}}, "encoder.counts_per_rev_front"),
        ({"reference": {"frame": "world"}}, "reference.frame"),
        ({"reference": {"frame": ["map"]}}, "reference.frame"),
        ({"reference": {"sensor_yaw_rad": 90}}, "reference.sensor_yaw_rad"),
        ({"reference": {"sensor_x_m": 250}}, "reference.sensor_x_m"),
        ({"reference": {"sensor_y_m": math.nan}}, "reference.sensor_y_m"),
        ({"odometry": {"from": "laser"}}, "odometry.from"),
        ({"odometry": {"from": "wheels"}}, "odometry.from"),
        ({"odometry": {"from": "front"}, "vehicle": {"drive": "differential"}}, "odometry.from"),
        ({"odometry": "rear"}, "odometry"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(sections: dict[str, dict[str, object]], column: str) -> None:
    """The message names the key, what stands there and what may stand there."""
    merged = {
        name: {**PLAIN.get(name, {}), **keys} if isinstance(keys, dict) else keys for name, keys in sections.items()
    }
    with pytest.raises(BadFileError, match=rf"column {column}: found .*; expected .*"):
        parse_settings({"format": "calib-campaign/1", **PLAIN, **merged}, "campaign.toml", "made")


def test_a_key_that_is_not_known_is_said(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text('[odometry]\nfrom = "rear"\nrate_Hz = 50\n')
    settings = read_settings(tmp_path / "campaign.toml", "campaign.toml")
    assert settings.odometry.source == "rear"
    assert [note.where for note in settings.notes if note.code == "key"] == ["campaign.toml, odometry.rate_Hz"]
    assert settings.extra == {"odometry": {"rate_Hz": 50}}


def test_a_short_vehicle_without_a_centre_of_mass_is_read() -> None:
    """The default stands where it does on a longer one; what is stated is refused beyond the front wheel."""
    assert parsed(vehicle={"wheelbase_m": 0.3}).vehicle.cog_x_m == pytest.approx(0.388 * 0.3, rel=ROUNDING)
    assert parsed(vehicle={"wheelbase_mm": 450}).vehicle.cog_x_m == 0.388
    with pytest.raises(BadFileError, match=r"column vehicle.cog_x_m: found 0\.35"):
        parsed(vehicle={"wheelbase_m": 0.3, "cog_x_m": 0.35})
