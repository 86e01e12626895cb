"""A laboratory's export goes in with one description, one edited mapping and one ingestion, in two variants."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.check import check_campaign
from calib.campaign.ingest.build import Ingested, ingest, merged_notes
from calib.campaign.read import read_campaign
from calib.errors import BadInputError
from tests.campaign.ingest.lab import MISSING, N_RUNS, SWAPPED, TWICE, Lab

#: lines that a mapping may have, remarks omitted
MOST_LINES = 30
#: distances are written to 0.1 mm
WRITTEN_M = 5.1e-5
#: a screen
SCREEN_LINES = 24

VARIANTS = ("german", "plain")
Laboratory = Callable[[str], tuple[Lab, str]]
STATED = {
    "track_m": "0.7",
    "wheelbase_m": "1.0",
    "wheel_radius_m": "0.1",
    "mass_kg": "100",
    "cog_x_m": "0.388",
    "counts_per_rev": "4096",
}


def edited(text: str) -> str:
    """What a user does to the proposal: state the vehicle and the encoder."""
    for key, value in STATED.items():
        text = re.sub(rf"#{key} = .*", f"{key} = {value}", text)
    return text


@pytest.fixture(scope="module", params=VARIANTS)
def ingested_lab(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, laboratory: Laboratory
) -> tuple[Lab, str, Ingested]:
    folder = tmp_path_factory.mktemp(request.param)
    lab, proposed = laboratory(request.param)
    mapping = folder / "mapping.toml"
    mapping.write_text(edited(proposed), encoding="utf-8")
    return lab, mapping.read_text(encoding="utf-8"), ingest([lab.table, lab.logs], folder / "c", mapping=mapping)


def test_the_mapping_is_short(ingested_lab: tuple[Lab, str, Ingested]) -> None:
    lines = [line for line in ingested_lab[1].splitlines() if line.strip() and not line.startswith("#")]
    assert len(lines) <= MOST_LINES, lines


def test_every_run_is_there_as_it_was_driven(ingested_lab: tuple[Lab, str, Ingested]) -> None:
    """Distances, loads, directions and sessions of all runs; counts but of those without a log or swapped."""
    lab, _, ingested = ingested_lab
    runs, true = read_campaign(ingested.folder).runs, lab.truth.runs
    assert len(runs) == N_RUNS
    np.testing.assert_allclose(runs.number("distance_m"), true.number("distance_m"), atol=WRITTEN_M)
    np.testing.assert_array_equal(runs.number("payload_kg"), true.number("payload_kg"))
    np.testing.assert_allclose(runs.number("load_left_N"), true.number("load_left_N"), atol=0.06)
    assert runs.label("direction").tolist() == true.label("direction").tolist()
    assert len(set(runs.label("session").tolist())) == 4
    others = ~np.isin(np.arange(1, N_RUNS + 1), (MISSING, SWAPPED))
    for side in ("left", "right"):
        name = f"counts_{side}"
        np.testing.assert_array_equal(runs.number(name)[others], true.number(name)[others])


def test_faults_of_the_export_are_noted(ingested_lab: tuple[Lab, str, Ingested]) -> None:
    """The missing log flags its run, the row pasted twice is dropped, the swapped wheels are suspected by name."""
    _, _, ingested = ingested_lab
    codes = [note.code for note in ingested.notes]
    assert codes.count("repeated_row") == 1
    assert codes.count("no_log") == 1
    campaign = read_campaign(ingested.folder)
    assert np.flatnonzero(campaign.runs.excluded).tolist() == [MISSING - 1]
    assert "was found" in campaign.runs.label("exclusion_reason")[MISSING - 1]
    swapped = [note for note in check_campaign(campaign).suspicious if note.code == "swapped_wheels"]
    assert {note.run_id for note in swapped} == {str(campaign.runs.run_id[SWAPPED - 1])}
    assert TWICE not in (MISSING, SWAPPED)


def test_the_width_of_the_counters_is_kept(ingested_lab: tuple[Lab, str, Ingested]) -> None:
    _, mapping, ingested = ingested_lab
    assert "wrap_bits = 16" in mapping
    assert read_campaign(ingested.folder).encoder.wrap_bits == 16


def test_what_is_not_stated_is_marked(ingested_lab: tuple[Lab, str, Ingested]) -> None:
    _, _, ingested = ingested_lab
    campaign = read_campaign(ingested.folder)
    assert "rangefinder.sigma_m" in campaign.assumed
    assert not {key for key in campaign.assumed if key.startswith(("vehicle.", "encoder."))}
    assert any(
        note.code == "assumed" and "rangefinder.sigma_m = 0.0015" in note.text for note in check_campaign(campaign).info
    )


def test_notes_fill_a_screen_at_most(ingested_lab: tuple[Lab, str, Ingested]) -> None:
    """24 runs and their logs: notes that differ in numbers alone are merged."""
    _, _, ingested = ingested_lab
    shown = merged_notes(ingested.notes)
    assert len(shown) < SCREEN_LINES, [note.text for note in shown]


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_description_lists_the_contents_of_the_files(variant: str, laboratory: Laboratory) -> None:
    text = laboratory(variant)[1]
    # where a line of a remark is broken depends on the folder's name
    assert "23 files alike" in text.replace("\n#   ", " ")
    assert "overflows at 16 bits" in text
    assert all(len(line) <= 100 for line in text.splitlines() if line.startswith("#")), text
    if variant == "german":
        for words in ("'Messungen' was read", "header was found in row 3", "row 7", "semicolons", "decimal commas"):
            assert words in text
        assert '{hin = "out", zurueck = "back"}' in text
        assert 'file = "Lauf_{n:02}.csv"' in text


def test_the_width_need_not_be_stated(tmp_path: Path, laboratory: Laboratory) -> None:
    """Without wrap_bits in the mapping it is found in the jumps, noted, and written."""
    lab, proposed = laboratory("plain")
    mapping = tmp_path / "m.toml"
    mapping.write_text(edited(proposed).replace("wrap_bits = 16", "#"), encoding="utf-8")
    ingested = ingest([lab.table, lab.logs], tmp_path / "c", mapping=mapping)
    assert "wrap_bits" in {note.code for note in ingested.notes}
    assert "wrap_bits = 16" in (tmp_path / "c" / "campaign.toml").read_text()


def test_a_dry_run_writes_nothing(tmp_path: Path, laboratory: Laboratory) -> None:
    lab, proposed = laboratory("plain")
    mapping = tmp_path / "m.toml"
    mapping.write_text(edited(proposed))
    ingested = ingest([lab.table, lab.logs], tmp_path / "c", mapping=mapping, dry_run=True)
    assert (ingested.n_runs, ingested.n_logs) == (N_RUNS, N_RUNS - 1)
    assert not (tmp_path / "c").exists()


def test_exchanged_wheels_are_corrected_where_the_mapping_says_so(tmp_path: Path, laboratory: Laboratory) -> None:
    """Named in the mapping, the run's counts are the true ones, and nothing is suspected any more."""
    lab, proposed = laboratory("german")
    mapping = tmp_path / "m.toml"
    text = edited(proposed).replace("[log]", f'[log]\nswapped = ["Lauf {SWAPPED}"] #')
    mapping.write_text(text, encoding="utf-8")
    ingest([lab.table, lab.logs], tmp_path / "c", mapping=mapping)
    campaign = read_campaign(tmp_path / "c")
    true = lab.truth.runs.number("counts_left")[SWAPPED - 1]
    assert campaign.runs.number("counts_left")[SWAPPED - 1] == true
    assert "swapped_wheels" not in {note.code for note in check_campaign(campaign).suspicious}
    mapping.write_text(text.replace(f"Lauf {SWAPPED}", "Lauf 99"), encoding="utf-8")
    with pytest.raises(BadInputError, match=r"log.swapped: found 'Lauf 99'"):
        ingest([lab.table, lab.logs], tmp_path / "d", mapping=mapping)
