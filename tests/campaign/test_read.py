from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.errors import BadFileError
from calib.io import inside
from tests.campaign.making import campaign

TOML = """format = "calib-campaign/1"
name = "small"
[vehicle]
track_m = 0.7
wheel_radius_m = 0.1
[encoder]
counts_per_rev = 4096
"""
RUNS = "run_id,session,distance_m,counts_left,counts_right,payload_kg,payload_x_m,payload_y_m\n"


def folder(tmp_path: Path, runs: str | bytes, toml: str = TOML, **logs: str | bytes) -> Path:
    (tmp_path / "campaign.toml").write_text(toml)
    (tmp_path / "runs.csv").write_bytes(runs if isinstance(runs, bytes) else runs.encode())
    (tmp_path / "logs").mkdir(exist_ok=True)
    for name, text in logs.items():
        (tmp_path / "logs" / f"{name}.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return tmp_path


def codes(made: Campaign) -> set[str]:
    return {note.code for note in made.notes}


def test_a_missing_model_is_the_nominal_vehicle(tmp_path: Path) -> None:
    made = read_campaign(folder(tmp_path, RUNS + "a,s,40,260000,260000,0,,\n"))
    assert (made.model.radius_left_m, made.model.track_m, made.model.slope_left_m_per_N) == (0.1, 0.7, 0.0)
    assert made.model.reference_load_N == made.vehicle.unladen_load_N


def test_loads_are_computed_from_the_payload_and_said(tmp_path: Path) -> None:
    """Fig. 3: 100 kg at x 0.50 m, y -0.2333..0.2333 m give 212.55 to 866.55 N, and 294.3 N without payload."""
    toml = TOML.replace("[encoder]", "cog_x_m = 0.40\n[encoder]")
    rows = "a,s,40,1,1,100,0.5,-0.23333333\nb,s,40,1,1,100,0.5,0.23333333\nc,s,40,1,1,0,,\n"
    made = read_campaign(folder(tmp_path, RUNS + rows, toml))
    # the table states its numbers to 0.01 N
    np.testing.assert_allclose(made.runs.number("load_left_N"), [212.55, 866.55, 294.3], rtol=0, atol=0.005)
    np.testing.assert_allclose(made.runs.number("load_right_N"), [866.55, 212.55, 294.3], rtol=0, atol=0.005)
    assert "computed_load" in codes(made)


@pytest.mark.parametrize(
    "data",
    [
        b"run_id;distance_m;counts_left;counts_right\na;40,25;260000;260001\nb;41,5;270000;270001\n",
        b"run_id\tdistance_m\tcounts_left\tcounts_right\na\t40.25\t260000\t260001\nb\t41.5\t270000\t270001\n",
        "\ufeffrun_id,distance_m,counts_left,counts_right\r\na,40.25,260000,260001\r\nb,41.5,270000,270001\r\n".encode(),
        "run_id,distance_m,counts_left,counts_right\na,40.25,260000,260001\nb,41.5,270000,270001\n".encode("utf-16"),
        b"run_id,distance_mm,counts_left,counts_right\na,40250,260000,260001\nb,41500,270000,270001\n",
        b"run_id,distance [cm],counts_left,counts_right\na,4025,260000,260001\nb,4150,270000,270001\n",
        b'run_id,distance_m,counts_left,counts_right\na,"40,25",260000,260001\nb,"41,5",270000,270001\n',
        "Run_ID,Distance_m,Counts_Left,Counts_Right,größe\na,40.25,260000,260001,x\nb,41.5,270000,270001,y\n".encode(
            "latin-1"
        ),
    ],
    ids=["semicolon-comma", "tabs", "bom-crlf", "utf-16", "mm", "cm-brackets", "quoted-comma", "case-latin-1"],
)
def test_every_way_of_writing_a_table_gives_the_same_numbers_and_is_said(tmp_path: Path, data: bytes) -> None:
    made = read_campaign(folder(tmp_path, data))
    np.testing.assert_allclose(made.runs.number("distance_m"), [40.25, 41.5], rtol=1e-15)
    assert made.runs.number("counts_right").tolist() == [260001, 270001]
    assert codes(made) & {"delimiter", "decimal_comma", "encoding", "unit", "name"}


@pytest.mark.parametrize("cell", ["1,234", "12,345"])
def test_a_number_that_can_be_read_in_two_ways_is_refused(tmp_path: Path, cell: str) -> None:
    with pytest.raises(BadFileError, match=r"row 2, column distance_m: found '.*which may mean"):
        read_campaign(folder(tmp_path, f"run_id;distance_m\na;{cell}\n"))


def test_the_rest_of_the_file_settles_an_ambiguous_number(tmp_path: Path) -> None:
    made = read_campaign(folder(tmp_path, "run_id;distance_m\na;12,345\nb;40,5\n"))
    assert made.runs.number("distance_m").tolist() == [12.345, 40.5]


@pytest.mark.parametrize("cell", ["1_000", "inf", "1e999", "1e300", "0x10", "abc", "1.2.3", "٣"])
def test_what_is_no_number_is_refused_with_its_cell(tmp_path: Path, cell: str) -> None:
    with pytest.raises(BadFileError, match=r"runs.csv, row 3, column distance_m"):
        read_campaign(folder(tmp_path, f"run_id,distance_m\na,40\nb,{cell}\n"))


def test_a_column_without_a_unit_is_not_guessed(tmp_path: Path) -> None:
    made = read_campaign(folder(tmp_path, "run_id,distance\na,40\n"))
    assert "distance_m" not in made.runs.numbers
    assert "no_unit" in codes(made)


def test_units_of_further_columns_are_converted_too(tmp_path: Path) -> None:
    made = read_campaign(folder(tmp_path, "run_id,distance_m,static_radius_left_mm\na,40,98.5\n"))
    np.testing.assert_allclose(made.runs.numbers["static_radius_left_m"], [0.0985], rtol=1e-15)


def test_units_of_settings_are_converted(tmp_path: Path) -> None:
    made = read_campaign(folder(tmp_path, "run_id\na\n", TOML.replace("track_m = 0.7", "track_mm = 700")))
    assert made.vehicle.track_m == pytest.approx(0.7, rel=1e-15)
    assert "unit" in codes(made)


def _log(counts: np.ndarray, step: float = 0.01, name: str = "t_s") -> str:
    rows = "".join(f"{i * step:.4f},{int(c)},{int(c)}\n" for i, c in enumerate(counts))
    return f"{name},counts_left,counts_right\n" + rows


@pytest.mark.parametrize(("bits", "signed"), [(16, False), (16, True), (32, False), (32, True)])
@pytest.mark.parametrize("given", [False, True])
def test_overflows_are_undone_and_said(tmp_path: Path, bits: int, signed: bool, given: bool) -> None:
    true = 2 ** (bits - 1) - 3000 + np.arange(2000) * (65 if bits == 16 else 1_300_003)
    wrapped = np.mod(true, 2**bits)
    wrapped = np.where(signed & (wrapped >= 2 ** (bits - 1)), wrapped - 2**bits, wrapped)
    toml = TOML + (f"wrap_bits = {bits}\n" if given else "")
    made = read_campaign(folder(tmp_path, "run_id,distance_m\na,40\n", toml, a=_log(wrapped)))
    np.testing.assert_array_equal(np.diff(made.logs.columns["counts_left"]), np.diff(true))
    assert made.runs.number("counts_left").tolist() == [float(true[-1] - true[0])]
    assert "wrap" in codes(made)


@pytest.mark.parametrize("full", [2.0 * np.pi, 360.0])
def test_a_steering_angle_that_starts_again_at_zero_is_counted_about_it(tmp_path: Path, full: float) -> None:
    """A wheel is not steered by half a turn from one sample to the next; whole turns alone say which unit it is."""
    true = 0.3 * np.sin(np.arange(40) / 5.0)
    lines = [
        f"{0.02 * n:.2f},{n},{n},{np.mod(angle, 2.0 * np.pi) * full / 2.0 / np.pi:.9f}" for n, angle in enumerate(true)
    ]
    log = "\n".join(["t_s,counts_left,counts_right,steer_rad", *lines, ""])
    made = read_campaign(folder(tmp_path, "run_id,distance_m\na,40\n", TOML, a=log))
    read = made.logs.columns["steer_rad"]
    assert bool(np.abs(read - true).max() < 1e-8) is (full < 7.0)
    assert ("wrap" in codes(made)) is (full < 7.0)


def test_a_real_jump_is_not_taken_for_an_overflow(tmp_path: Path) -> None:
    counts = np.arange(2000) * 65
    counts[1000:] += 20000
    made = read_campaign(folder(tmp_path, "run_id\na\n", a=_log(counts)))
    np.testing.assert_array_equal(made.logs.columns["counts_left"], counts)
    assert "wrap" not in codes(made)


def test_a_wrapped_total_is_set_right_by_the_log_or_by_the_distance(tmp_path: Path) -> None:
    counts = np.arange(4001) * 65  # 260000
    rest = 260000 % 65536
    table = f"run_id,distance_m,counts_left,counts_right\na,40,{rest},{rest}\nb,40,{rest},{rest}\n"
    made = read_campaign(folder(tmp_path, table, TOML + "wrap_bits = 16\n", a=_log(counts)))
    assert made.runs.number("counts_left").tolist() == [260000.0, 260000.0]
    assert "wrapped_total" in codes(made)


def test_a_log_in_milliseconds_from_an_epoch_starts_at_zero(tmp_path: Path) -> None:
    text = "t_ms,counts_left,counts_right\n1700000000000,0,0\n1700000000010,5,5\n1700000000020,9,9\n"
    made = read_campaign(folder(tmp_path, "run_id\na\n", a=text))
    # a double holds an epoch in seconds to 0.2 microseconds
    np.testing.assert_allclose(made.logs.columns["t_s"], [0.0, 0.01, 0.02], rtol=0, atol=5e-7)


@pytest.mark.parametrize(
    "text",
    [
        "t_s;counts_left;counts_right\n0,00;0;0\n0,01;5;6\n0,02;9;9\n",
        "t_s,counts_left,counts_right\n0.00,0,0\n0.01,5,6\n0.02,9,9",
        't_s,counts_left,counts_right\n"0.00","0","0"\n"0.01","5","6"\n"0.02","9","9"\n',
        "t_s,counts_left,counts_right,remark\n0.00,0,0,start\n0.01,5,6,\n0.02,9,9,end\n",
        "t_s,counts_left,counts_right,\n0.00,0,0,\n0.01,5,6,\n0.02,9,9,\n",
        "counts_right,t_ms,counts_left\r\n0,0,0\r\n6,10,5\r\n9,20,9\r\n\r\n",
    ],
    ids=["decimal-comma", "no-last-newline", "quoted", "text-column", "trailing-comma", "order-ms-crlf-blank"],
)
def test_every_way_of_writing_a_log_gives_the_same_samples(tmp_path: Path, text: str) -> None:
    made = read_campaign(folder(tmp_path, "run_id\na\n", a=text))
    np.testing.assert_allclose(made.logs.columns["t_s"], [0.0, 0.01, 0.02], rtol=1e-15)
    assert made.logs.columns["counts_left"].tolist() == [0, 5, 9]
    assert made.logs.columns["counts_right"].tolist() == [0, 6, 9]


@pytest.mark.parametrize(
    ("text", "row"),
    [
        ("t_s,counts_left,counts_right\n0,0,0\n0.01,5\n", 3),
        ("t_s,counts_left,counts_right\n0,0,0\n0.01,5,6,7\n", 3),
        ("t_s,counts_left,counts_right\n0,0,0\n0.01,,6\n", 3),
        ("t_s,counts_left,counts_right\n0,0,0\n0.01,5,nan\n", 3),
        ("t_s,counts_left,counts_right\n0,0,0\n0.01,5,x\n", 3),
        ("t_s,counts_left,counts_right\n0,0,0\n0.01,5,1e400\n", 3),
        ("t_s,counts_left\n0,0\n", 1),
        ("t_s,counts_left,counts_left\n0,0,0\n", 1),
        ("t_s,counts_left,counts_right\n0,0,0\n0.01,5\0,6\n", 3),
    ],
)
def test_a_fault_in_a_log_is_named_by_its_row(tmp_path: Path, text: str, row: int) -> None:
    made = folder(tmp_path, "run_id\na\n", a=text)
    with pytest.raises(BadFileError, match=rf"/logs/a.csv, row {row}[,:]"):
        read_campaign(made)
    (note,) = [note for note in read_campaign(made, lenient=True).notes if note.level == "wrong"]
    assert note.run_id == "a"


@pytest.mark.parametrize(
    "path", ["../outside.csv", "/etc/hostname", "logs/../../outside.csv", "logs/link.csv", "a\\0b"]
)
def test_a_log_path_never_leads_out_of_the_campaign(tmp_path: Path, path: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "outside.csv").write_text("t_s,counts_left,counts_right\n0,0,0\n1,1,1\n")
    made = folder(inner, f"run_id,log\na,{path}\n")
    (made / "logs" / "link.csv").symlink_to(tmp_path / "outside.csv")
    with pytest.raises(BadFileError, match="row 2, column log"):
        read_campaign(made)


def test_a_folder_of_logs_never_leads_out_of_the_campaign(tmp_path: Path) -> None:
    """A plain file in a folder that is a link is as far away as the folder."""
    inner = tmp_path / "inner"
    inner.mkdir()
    made = folder(inner, "run_id,log\na,logs/a.csv\n")
    (made / "logs").rename(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "a.csv").write_text("t_s,counts_left,counts_right\n0,0,0\n1,1,1\n")
    (made / "logs").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(BadFileError, match="row 2, column log"):
        read_campaign(made)


def test_parquet_and_xlsx_give_what_csv_gives(tmp_path: Path) -> None:
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    made = campaign(runs_per_load=1)
    one = write_campaign(made, tmp_path / "one")
    two = write_campaign(made, tmp_path / "two")
    table = pd.read_csv(two / "runs.csv")
    for index, path in enumerate(sorted((two / "logs").iterdir())):
        frame = pd.read_csv(path)
        if index % 2:
            frame.to_parquet(path.with_suffix(".parquet"))
            table.loc[index, "log"] = f"logs/{path.stem}.parquet"
        else:
            frame.to_excel(path.with_suffix(".xlsx"), index=False)
            table.loc[index, "log"] = f"logs/{path.stem}.xlsx"
        path.unlink()
    table.to_excel(two / "runs.xlsx", index=False)
    (two / "runs.csv").unlink()
    first, second = read_campaign(one), read_campaign(two)
    for name, column in first.runs.numbers.items():
        np.testing.assert_array_equal(second.runs.numbers[name], column)
    for name, column in first.logs.columns.items():
        np.testing.assert_array_equal(second.logs.columns[name], column)


def test_a_missing_extra_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    (tmp_path / "campaign.toml").write_text(TOML)
    (tmp_path / "runs.parquet").write_bytes(b"PAR1")
    with pytest.raises(BadFileError, match=r"pip install 'calib\[parquet\]'"):
        read_campaign(tmp_path)


def test_a_run_id_given_twice_is_refused_and_a_check_names_it(tmp_path: Path) -> None:
    made = folder(tmp_path, "run_id,distance_m\na,1\na,2\n")
    with pytest.raises(BadFileError, match="row 3, column run_id: found 'a', as in row 2"):
        read_campaign(made)
    assert "duplicate_run" in codes(read_campaign(made, lenient=True))


def test_files_read_are_hashed(tmp_path: Path) -> None:
    import hashlib

    made = read_campaign(write_campaign(campaign(runs_per_load=1), tmp_path / "c"))
    assert len(made.hashes) == 7
    for name, digest in made.hashes.items():
        assert digest == hashlib.sha256((tmp_path / "c" / name).read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("name", "meant"), [("Runs.csv", "runs.csv"), ("runs.xlsx", "runs.csv"), ("Campaign.toml", "campaign.toml")]
)
def test_a_look_alike_that_is_not_read_is_named(name: str, meant: str, tmp_path: Path) -> None:
    """Another case or another format beside the file that counts."""
    made = folder(tmp_path, RUNS + "a,s,10,100,100,0,0,0\n")
    (made / name).write_text("nothing to read")
    (note,) = (note for note in read_campaign(made).notes if note.code == "look_alike")
    assert (note.where, note.level) == (name, "suspicious")
    assert meant in note.text


def test_a_campaign_without_logs_is_read(tmp_path: Path) -> None:
    made = read_campaign(folder(tmp_path, RUNS + "a,s,10,100,100,0,0,0\n"))
    assert (len(made.runs), int(made.logs.lengths.sum())) == (1, 0)


def test_a_log_that_is_a_link_out_of_the_campaign_is_said_to_be_one(tmp_path: Path) -> None:
    (tmp_path / "campaign").mkdir()
    (tmp_path / "log.csv").write_text("t_s\n")
    (tmp_path / "campaign" / "log.csv").symlink_to(tmp_path / "log.csv")
    with pytest.raises(BadFileError, match="a link"):
        inside(tmp_path / "campaign", "log.csv", named_in="runs.csv")


def test_a_folder_without_settings_is_named_by_its_path(tmp_path: Path) -> None:
    with pytest.raises(BadFileError, match=re.escape(str(tmp_path / "campaign.toml"))):
        read_campaign(tmp_path)
