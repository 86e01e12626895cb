"""Sound inputs of every format, small, that the damage starts from."""

from __future__ import annotations

import contextlib
import io
import shutil
from pathlib import Path

from calib.cli.main import run
from tests.campaign.readers.recordings import weave, write_rosbag1, write_rosbag2, write_tdms

ROOT = Path(__file__).resolve().parents[2]
MAPPING = """[table]
run_id = "run_id"
distance_m = {column = "distance_m", factor = 1.0}
session = {value = "x"}
[log]
file = "{run_id}.csv"
"""
ROUTE = """format = "calib-route/1"
name = "bend"
[[segment]]
straight_m = 4.0
[[segment]]
turn_deg = 90.0
radius_m = 1.0
"""
#: one case with nothing planted, which is made quickly
SEEDS = """format = "calib-challenge-seeds/1"
purpose = "ci"
seed = 40417
max_runs = 20
[cases]
empty = 1
"""


def small_campaign(folder: Path) -> Path:
    """Make a campaign of a dozen runs, three of them with short logs, out of the samples."""
    source = ROOT / "sample_runs" / "corridor"
    folder.mkdir(parents=True)
    shutil.copy(source / "campaign.toml", folder)
    lines = (source / "runs.csv").read_text(encoding="utf-8").splitlines()
    kept = [lines[0]]
    (folder / "logs").mkdir()
    for number, line in enumerate(lines[1::5][:12]):
        cells = line.split(",")
        if number < 3:
            text = (source / cells[-1]).read_text(encoding="utf-8").splitlines()
            (folder / cells[-1]).write_text("\n".join([text[0], *text[1:-1:20], text[-1]]) + "\n", encoding="utf-8")
        else:
            cells[-1] = ""
        kept.append(",".join(cells))
    (folder / "runs.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder


def prepared(base: Path) -> Path:
    """Make the sound inputs below `base` and return it."""
    campaign = small_campaign(base / "C")
    for arguments in (
        ["fit", str(campaign), "--into", str(base / "result")],
        ["export", str(campaign), "--to", "json", "--output", str(base / "coefficients.json")],
    ):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            run(arguments)
    (base / "mapping.toml").write_text(MAPPING, encoding="utf-8")
    (base / "route.toml").write_text(ROUTE, encoding="utf-8")
    shutil.copy(ROOT / "sample_runs" / "plan.toml", base / "plan.toml")
    (base / "seeds.toml").write_text(SEEDS, encoding="utf-8")
    (base / "path.tum").write_text(
        "".join(f"{0.1 * step:.1f} {0.05 * step:.2f} 0 0 0 0 0 1\n" for step in range(60)), encoding="utf-8"
    )
    import pandas as pd
    import scipy.io

    table = pd.read_csv(campaign / "runs.csv")
    table.to_excel(base / "runs.xlsx", index=False)
    log = pd.read_csv(campaign / "logs" / "r000.csv")
    scipy.io.savemat(base / "log.mat", {name: log[name].to_numpy() for name in log.columns})
    with contextlib.suppress(ImportError):
        table.to_parquet(base / "runs.parquet", index=False)
    with contextlib.suppress(ImportError):
        write_tdms(weave(0.4), base / "log.tdms")
    with contextlib.suppress(ImportError):
        write_rosbag1(weave(0.4), base / "drive.bag")
        for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
            folder = write_rosbag2(weave(0.4), base / suffix, storage)
            shutil.copy(next(folder.glob(f"*.{suffix}")), base / f"drive.{suffix}")
            shutil.rmtree(folder)
    shutil.copytree(campaign, base / "kept")
    return base
