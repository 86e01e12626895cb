"""Lines of where the gap lies, as the contract has them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.gap.diagnose import diagnose_in_full
from calib.gap.localise import PlaceResult
from calib.gap.localise.locate import ChannelGap, CovariateResult, GapLocation, RunDeviation
from calib.gap.observations import N_CHANNELS, Channel
from tests.real import recordings

ZONE = PlaceResult(
    "zone",
    Channel.ALONG,
    0.01,
    (0.008, 0.012),
    "m",
    1e-4,
    12,
    route="corridor",
    coordinate="x on the floor",
    place=(6.0, 8.0),
    place_ci95=((5.8, 6.2), (7.9, 8.1)),
    floor=((6.0, 0.0), (8.0, 0.0)),
)
TURNS = PlaceResult("turns", Channel.HEADING, -0.03, (-0.04, -0.02), "rad/rad", 1e-5, 12, what="per rad of signed turn")
WHERE = GapLocation(
    channels=(ChannelGap(Channel.DISTANCE, 0.3, 0.1, -0.2, 40), ChannelGap(Channel.HEADING, 0.02, 0.01)),
    covariates=(
        CovariateResult("turn", Channel.HEADING, 0.9, (0.8, 0.95), 1e-9, significant=True),
        CovariateResult("left wheel", None, 0.1, None, 0.3, significant=False),
    ),
    runs=(RunDeviation("r1", Channel.LATERAL, 0.1, 0.01, 10.0),),
    places=(ZONE, TURNS),
)


@pytest.mark.parametrize("channel", Channel)
def test_a_label_leads_back_to_its_channel(channel: Channel) -> None:
    assert Channel[channel.label.upper()] is channel
    assert channel.unit in {"m", "rad"}


def test_channels_are_the_columns_of_the_arrays() -> None:
    assert [int(channel) for channel in Channel] == list(range(N_CHANNELS))


def test_the_document_is_json_and_has_the_fields_of_the_contract() -> None:
    document = WHERE.to_dict()
    assert json.loads(json.dumps(document)) == document
    assert document["channels"]["heading"] == {"rms": 0.02, "floor": 0.01, "mean": 0.0, "unit": "rad", "n_units": 0}
    assert [line["channel"] for line in document["covariates"]] == ["heading", "all"]
    assert document["runs"][0]["channel"] == "lateral"


def test_a_stretch_has_its_ends_and_turns_have_what_they_count() -> None:
    zone, turns = (line.to_dict() for line in (ZONE, TURNS))
    assert zone["place"] == [6.0, 8.0] and "what" not in zone
    assert turns["what"] == "per rad of signed turn" and not {"place", "route", "floor"} & turns.keys()


def test_what_is_left_is_told_apart_from_the_gap_itself() -> None:
    assert "rest" not in WHERE.to_dict()
    assert GapLocation(rest=WHERE).to_dict()["rest"] == WHERE.to_dict()


def test_channels_and_lines_that_stand_are_looked_up() -> None:
    heading = WHERE.channel(Channel.HEADING)
    assert heading is not None and heading.ratio == 2.0
    assert WHERE.channel(Channel.FRONT) is None
    assert [line.name for line in WHERE.significant] == ["turn"]


def test_a_window_of_a_recording_is_named_by_its_time(shared_data: Path) -> None:
    """A recording cut into windows lists its outlying ones by when they were driven, each once."""
    diagnosis = diagnose_in_full(recordings.mecanum(shared_data, "bag2"), plan=False)
    assert diagnosis.observations.windowed
    names = [line.name for line in diagnosis.where.runs]
    assert len(set(names)) == len(names)
    for line in diagnosis.where.runs:
        assert line.from_s is not None and line.to_s is not None
        assert 0.0 <= line.from_s < line.to_s
        assert line.name.endswith(f"{line.from_s:.1f} s to {line.to_s:.1f} s")
