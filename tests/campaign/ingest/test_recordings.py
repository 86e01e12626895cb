"""A continuous recording becomes the campaign that was driven, in every format."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.read import read_campaign, read_or_ingest
from calib.errors import BadInputError
from tests.campaign.ingest.continuous import LOGS, Recorded, mapping_text, recorded, write

#: ROS keeps a range as float32, 4e-6 m at 45 m; other formats keep it exactly
RANGE_M = 8e-6
#: the range's rounding over 40 m, with room for how it spreads over a fit of ten runs
SAME_RADIUS = 1e-6
#: counts pass through radians and back
SAME_COUNTS = 1e-6


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return recorded(tmp_path_factory.mktemp("driven"))


@pytest.fixture(scope="module")
def folders(driven: Recorded, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The campaign out of each format."""
    folder = tmp_path_factory.mktemp("formats")
    out = {}
    for kind in LOGS:
        (folder / f"{kind}.toml").write_text(mapping_text(kind))
        source = write(driven.drive, folder, kind)
        ingest([driven.table, source], folder / f"c_{kind}", mapping=folder / f"{kind}.toml")
        out[kind] = folder / f"c_{kind}"
    return out


@pytest.mark.parametrize("kind", LOGS)
def test_runs_counts_and_distances_are_those_driven(kind: str, driven: Recorded, folders: dict[str, Path]) -> None:
    campaign = read_campaign(folders[kind])
    assert campaign.runs.run_id.tolist() == driven.truth.runs.run_id.tolist()
    for side in ("left", "right"):
        np.testing.assert_allclose(
            campaign.runs.number(f"counts_{side}"), driven.truth.runs.number(f"counts_{side}"), atol=SAME_COUNTS
        )
    np.testing.assert_allclose(campaign.runs.number("distance_m"), driven.truth.runs.number("distance_m"), atol=RANGE_M)


@pytest.mark.parametrize("kind", [kind for kind in LOGS if kind != "csv"])
def test_every_format_fits_as_the_csv(kind: str, folders: dict[str, Path]) -> None:
    from calib.radius.fit import fit_campaign

    ours, csv = (fit_campaign(read_campaign(folders[one])).to_dict()["wheels"] for one in (kind, "csv"))
    for side in ("left", "right"):
        assert ours[side]["radius_ref_m"] == pytest.approx(csv[side]["radius_ref_m"], rel=SAME_RADIUS)
        assert ours[side]["slope_m_per_N"] == pytest.approx(csv[side]["slope_m_per_N"], rel=1e-3)


def test_the_whole_recording_is_kept_with_what_was_cut(driven: Recorded, folders: dict[str, Path]) -> None:
    whole = (folders["mcap"] / "recordings" / "drive_mcap.csv").read_text().splitlines()
    assert len(whole) == 1 + len(driven.drive.wheels[0])
    record = json.loads((folders["mcap"] / "ingest.json").read_text())
    assert [one["run_id"] for one in record["cuts"]] == driven.truth.runs.run_id.tolist()
    first = record["cuts"][0]
    assert first["start_ns"] == int(driven.drive.wheels[0][0]) + round(first["start_s"] * 1e9)


def test_without_a_table_runs_are_numbered(driven: Recorded, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(
        mapping_text("csv") + '[table]\nkind = {value = "corridor"}\npayload_kg = {value = 100}\n'
    )
    ingested = ingest([write(driven.drive, tmp_path, "csv")], tmp_path / "c", mapping=tmp_path / "m.toml")
    assert ingested.campaign.runs.run_id.tolist() == [f"r{n:03}" for n in range(1, 11)]
    assert set(ingested.campaign.runs.label("session").tolist()) == {"drive"}
    assert set(ingested.campaign.runs.number("payload_kg").tolist()) == {100.0}


def test_a_file_read_directly_is_the_campaign_it_would_become(driven: Recorded, tmp_path: Path) -> None:
    source = write(driven.drive, tmp_path, "mcap")
    (tmp_path / "m.toml").write_text(mapping_text("mcap"))
    direct = read_or_ingest(source, mapping=tmp_path / "m.toml")
    ingest([source], tmp_path / "c", mapping=tmp_path / "m.toml")
    written = read_campaign(tmp_path / "c")
    assert direct.root is None
    for name in written.runs.numbers:
        np.testing.assert_array_equal(direct.runs.number(name), written.runs.number(name))
    for name in written.logs.columns:
        np.testing.assert_array_equal(direct.logs.columns[name], written.logs.columns[name])
    assert replace(direct.encoder) == written.encoder


def test_a_campaign_takes_no_mapping(folders: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="a campaign and a mapping"):
        read_or_ingest(folders["csv"], mapping=tmp_path / "m.toml")


def test_other_numbers_of_rows_and_runs_are_refused(driven: Recorded, tmp_path: Path) -> None:
    table = tmp_path / "runs.csv"
    table.write_text("\n".join(driven.table.read_text().splitlines()[:-1]) + "\n")
    (tmp_path / "m.toml").write_text(mapping_text("csv"))
    with pytest.raises(BadInputError, match=r"found 10 runs, cut by stops .* and 9 rows of the table"):
        ingest([table, write(driven.drive, tmp_path, "csv")], tmp_path / "c", mapping=tmp_path / "m.toml")


def test_a_missing_column_is_named_with_those_of_the_file(driven: Recorded, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(mapping_text("mcap").replace("position.left", "position.links"))
    with pytest.raises(BadInputError, match=r"no column '/joint_states:position.links', only .*position.left"):
        ingest([write(driven.drive, tmp_path, "mcap")], tmp_path / "c", mapping=tmp_path / "m.toml")


@pytest.mark.parametrize("bits", [16, 32])
def test_overflows_of_a_recording_are_undone_and_their_width_written(
    bits: int, driven: Recorded, tmp_path: Path
) -> None:
    time, left, right = driven.drive.wheels
    offset = 2**bits - 20_000
    wrapped = replace(driven.drive, wheels=(time, np.mod(left + offset, 2**bits), np.mod(right + offset, 2**bits)))
    (tmp_path / "m.toml").write_text(mapping_text("csv"))
    ingested = ingest([driven.table, write(wrapped, tmp_path, "csv")], tmp_path / "c", mapping=tmp_path / "m.toml")
    assert ingested.campaign.encoder.wrap_bits == bits
    assert f"wrap_bits = {bits}" in (tmp_path / "c" / "campaign.toml").read_text()
    campaign = read_campaign(tmp_path / "c")
    np.testing.assert_array_equal(campaign.runs.number("counts_left"), driven.truth.runs.number("counts_left"))


def test_a_table_named_in_the_mapping_goes_with_the_recording(driven: Recorded, tmp_path: Path) -> None:
    """One command from a recording to a campaign with its loads."""
    (tmp_path / "runs.csv").write_text(driven.table.read_text())
    (tmp_path / "m.toml").write_text(mapping_text("csv") + '[table]\nfile = "runs.csv"\n')
    campaign = read_or_ingest(write(driven.drive, tmp_path, "csv"), mapping=tmp_path / "m.toml")
    np.testing.assert_array_equal(campaign.runs.number("payload_kg"), driven.truth.runs.number("payload_kg"))
    (tmp_path / "m.toml").write_text(mapping_text("csv") + '[table]\nfile = "../runs.csv"\n')
    with pytest.raises(BadInputError, match=r"table.file"):
        read_or_ingest(write(driven.drive, tmp_path, "csv"), mapping=tmp_path / "m.toml")


def test_one_value_a_run(driven: Recorded, tmp_path: Path) -> None:
    loads = [float(value) for value in driven.truth.runs.number("payload_kg")]
    text = mapping_text("csv") + f"[table]\npayload_kg = {{value = {loads}}}\n"
    (tmp_path / "m.toml").write_text(text)
    campaign = read_or_ingest(write(driven.drive, tmp_path, "csv"), mapping=tmp_path / "m.toml")
    assert campaign.runs.number("payload_kg").tolist() == loads
    (tmp_path / "m.toml").write_text(text.replace("[0.0, ", "["))
    with pytest.raises(BadInputError, match=r"9 values.*one value for each of 10 runs"):
        read_or_ingest(write(driven.drive, tmp_path, "csv"), mapping=tmp_path / "m.toml")


def test_a_recording_among_the_logs_of_a_campaign_is_read(driven: Recorded, tmp_path: Path) -> None:
    """``logs/<run_id>.tdms`` with channels of calib's names needs no mapping."""
    from nptdms import ChannelObject, TdmsWriter

    (tmp_path / "logs").mkdir()
    (tmp_path / "runs.csv").write_text("run_id,distance_m\na,12.5\n")
    (tmp_path / "campaign.toml").write_text('format = "calib-campaign/1"\n')
    counts = np.arange(0, 5000, 50)
    with TdmsWriter(tmp_path / "logs" / "a.tdms") as daq:
        daq.write_segment(
            [
                ChannelObject("Encoder", name, counts + shift, {"wf_increment": 0.02, "wf_start_offset": 0.0})
                for shift, name in enumerate(("counts_left", "counts_right"))
            ]
        )
    log = read_campaign(tmp_path).logs.of(0)
    np.testing.assert_allclose(log["t_s"], 0.02 * np.arange(100), atol=1e-9)
    np.testing.assert_array_equal(log["counts_right"], counts + 1)
