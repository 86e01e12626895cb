"""A unit is read, asked for or refused: frames by their rate, increments by what they do, speeds never as counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.errors import CalibError

N_SAMPLES = 240
TIME_S = np.arange(N_SAMPLES) / 10
#: a drive from standstill to standstill, in counts a sample
RATE = np.clip(np.minimum(TIME_S - 2, 21 - TIME_S), 0, 1) * 140.4


def _csv(path: Path, columns: dict[str, np.ndarray], head: str = "") -> Path:
    rows = [",".join(columns), *(",".join(f"{cell:g}" for cell in row) for row in zip(*columns.values(), strict=True))]
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def _whole(rate: np.ndarray, seed: int) -> np.ndarray:
    """Return counts a sample of a counter whose edges fall anywhere."""
    phase = np.random.default_rng(seed).uniform(0, 1, len(rate) + 1)
    total = np.concatenate(([0.0], np.cumsum(rate)))
    return np.diff(np.floor(total + 0.3 * phase))


def _frames(folder: Path, head: str, first: int) -> list[Path]:
    """Write wheels with times, and a camera's file with frames of 25 a second."""
    frames = np.arange(N_SAMPLES * 5 // 2)
    total = np.cumsum(np.round(RATE))
    _csv(folder / "t1_wheels.csv", {"time_s": TIME_S, "ticks_left": total, "ticks_right": total})
    camera = {"Frame": frames + first, "cam_x_m": np.interp(frames / 25, TIME_S, total) / 4000, "cam_y_m": 0 * frames}
    return [_csv(folder / "t1_camera.csv", camera, head), folder / "t1_wheels.csv"]


@pytest.mark.parametrize("head", ["Recording\n25\n,,Body A\n", "# FREQUENCY\t25\nFREQUENCY,25\nBODIES,1\n"])
def test_frames_have_the_rate_that_their_file_states(head: str, tmp_path: Path) -> None:
    sources = _frames(tmp_path, head, first=0)
    (tmp_path / "m.toml").write_text(describe(sources).to_toml())
    made = ingest(sources, tmp_path / "c", mapping=tmp_path / "m.toml").campaign.logs.columns
    np.testing.assert_allclose(made["ref_x_m"], made["counts_left"] / 4000, atol=1e-3)


def test_a_rate_that_no_file_states_is_asked_for_and_taken(tmp_path: Path) -> None:
    sources = _frames(tmp_path, "", first=0)
    text = describe(sources).to_toml()
    assert 'camera = {column = "Frame", unit = "? Hz"}' in text
    mapping = tmp_path / "m.toml"
    mapping.write_text(text)
    with pytest.raises(CalibError, match=r"clocks\.camera: found '\? Hz'; expected one of s, ms, .* as \"50 Hz\""):
        ingest(sources, tmp_path / "c", mapping=mapping)
    mapping.write_text(text.replace("? Hz", "25 fps"))
    made = ingest(sources, tmp_path / "c", mapping=mapping).campaign.logs.columns
    np.testing.assert_allclose(made["ref_x_m"], made["counts_left"] / 4000, atol=1e-3)


@pytest.mark.parametrize("unit", ["bananas", "0.04 s", "Hz"])
@pytest.mark.parametrize("clocks", [True, False])
def test_a_clock_of_no_unit_is_refused(unit: str, clocks: bool, tmp_path: Path) -> None:
    sources = _frames(tmp_path, "", first=1)
    line = f'{{column = "Frame", unit = "{unit}"}}'
    files = 'files = {camera = "t{n}_camera.csv", wheels = "t{n}_wheels.csv"}'
    rest = f'clocks = {{camera = {line}, wheels = "time_s"}}' if clocks else f"t_s = {line}"
    (tmp_path / "m.toml").write_text(f'[log]\n{files}\n{rest}\ncounts_left = "wheels:ticks_left"\n')
    with pytest.raises(CalibError, match=r"expected one of s, ms, us, .* the rate of frames counted"):
        ingest(sources, tmp_path / "c", mapping=tmp_path / "m.toml")


@pytest.mark.parametrize("rate", [RATE, RATE * np.where(TIME_S % 8 < 4, 1.0, 0.5)])
def test_increments_about_a_level_are_told_from_totals(rate: np.ndarray, tmp_path: Path) -> None:
    """Two standstills and a drive between them, in counts a sample or as their sum."""
    steps = [_whole(rate, seed) for seed in (1, 2)]
    path = _csv(tmp_path / "a.csv", {"ms": 100 * np.arange(N_SAMPLES), "enc_l": steps[0], "enc_r": steps[1]})
    assert 'counts_left = {column = "enc_l", unit = "counts/sample"}' in describe([path]).to_toml()
    # there, a stop, and back to the start: a total, though it ends where it began
    there = np.concatenate((np.cumsum(steps[0])[::3], np.cumsum(steps[0])[::-3]))
    other = np.concatenate((np.cumsum(steps[1])[::3], np.cumsum(steps[1])[::-3]))
    total = {"ms": 100 * np.arange(len(there)), "enc_l": there, "enc_r": other}
    assert "counts/sample" not in describe([_csv(tmp_path / "b.csv", total)]).to_toml()


@pytest.mark.parametrize("names", [("v_left [m/s]", "v_right [m/s]"), ("wl_radps", "wr_radps"), ("speed_l", "speed_r")])
def test_speeds_are_not_counted(names: tuple[str, str], tmp_path: Path) -> None:
    path = _csv(tmp_path / "a.csv", {"t_s": TIME_S, names[0]: RATE / 200, names[1]: RATE / 200})
    lines = [f'counts_left = "{names[0]}"', f'counts_right = "{names[1]}"']
    (tmp_path / "m.toml").write_text("[log]\n" + "\n".join(lines) + "\n")
    with pytest.raises(CalibError, match=r"a speed or rate by its name.*mapped to counts_left.*speed_left_mps"):
        ingest([path], tmp_path / "c", mapping=tmp_path / "m.toml")
    # what the user states is taken
    stated = [line.replace(' = "', ' = {column = "') + ', unit = "counts"}' for line in lines]
    (tmp_path / "m.toml").write_text("[log]\n" + "\n".join(stated) + "\n")
    ingest([path], tmp_path / "c", mapping=tmp_path / "m.toml")


@pytest.mark.parametrize(("unit", "factor"), [("rad/s", 1.0), ("deg/s", np.pi / 180.0), ("degps", np.pi / 180.0)])
def test_a_rate_of_turn_has_its_unit_as_people_write_it(unit: str, factor: float, tmp_path: Path) -> None:
    """Of a wheel's counts ``rad/s`` is a unit of its own; of `omega_radps` it is the suffix."""
    rows = "".join(f"{0.05 * n:.2f},0.5,0.1\n" for n in range(100))
    (tmp_path / "a.csv").write_text("time,v,w\n" + rows)
    (tmp_path / "m.toml").write_text(
        '[log]\nt_s = "time"\nv_mps = {column = "v", unit = "m/s"}\n'
        f'omega_radps = {{column = "w", unit = "{unit}"}}\n'
        '[encoder]\nkind = "speed"\n'
    )
    made = ingest([tmp_path / "a.csv"], tmp_path / "c", mapping=tmp_path / "m.toml")
    assert made.campaign.logs.of(0)["omega_radps"][1] == pytest.approx(0.1 * factor)
