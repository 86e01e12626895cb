"""An empty campaign with a remark beside every key, to be filled in by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from calib.campaign.settings_file import FORMAT
from calib.campaign.toml_text import to_toml
from calib.errors import would_overwrite
from calib.files import write_text

#: columns of an empty run table; those that do not apply may be taken out
RUNS_HEADER: Final = (
    "run_id",
    "session",
    "kind",
    "direction",
    "payload_kg",
    "payload_x_m",
    "payload_y_m",
    "speed_mps",
    "distance_m",
    "counts_left",
    "counts_right",
    "log",
    "excluded",
    "exclusion_reason",
)

_SETTINGS: Final = """simulated = false          # true: a program made the data; every report then says so

# Take out the '#' before a key and give your own value. What stays out is assumed, and 'calib check' and every report
# say so. A unit may differ if the key names it: track_mm = 700.

[vehicle]
#drive = "tricycle"        # or "differential", "mecanum"
#track_m = 0.700           # between the contact points of the rear wheels
#wheelbase_m = 1.000       # rear axle to front wheel
#wheel_radius_m = 0.100    # nominal free radius
#mass_kg = 100.0           # without payload
#cog_x_m = 0.388           # centre of mass ahead of the rear axle
#cog_y_m = 0.0             # left positive

[encoder]
#counts_per_rev = 4096     # counts a wheel revolution, gear and quadrature included
#wrap_bits = 16            # width of the counter, where it overflows

[rangefinder]
#sigma_m = 0.0015          # standard uncertainty of one distance

#[reference]               # end poses or trajectories, where there are any
#sigma_xy_m = 0.002
#sigma_theta_rad = 0.0008
#frame = "start"           # poses in each run's own start frame, or "map": one frame for all runs

#[model]                   # what the simulator believes; without it the nominal vehicle above
#radius_left_m = 0.100
#radius_right_m = 0.100
#track_m = 0.700
#reference_load_N = 300.0
"""


def write_blank(folder: Path, *, force: bool = False) -> tuple[Path, ...]:
    """Write an empty campaign: ``campaign.toml`` with remarks, ``runs.csv`` with its header, and ``logs``.

    `folder`: the campaign to make; its name becomes the campaign's. Raises BadInputError where a campaign stands there
    and `force` is False.
    """
    settings, runs = folder / "campaign.toml", folder / "runs.csv"
    for path in (settings, runs):
        if path.exists() and not force:
            raise would_overwrite(path)
    head = to_toml({"format": FORMAT, "name": folder.resolve().name})
    write_text(settings, head + _SETTINGS, force=force)
    write_text(runs, ",".join(RUNS_HEADER) + "\n", force=force)
    (folder / "logs").mkdir(exist_ok=True)
    return settings, runs, folder / "logs"
