"""Exports in other languages, or with names of their own: the run table is found and its columns proposed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.campaign.ingest.guesses import guessed_log_column, guessed_table_column
from calib.campaign.read import read_campaign

VEHICLE = '\n[vehicle]\ndrive = "differential"\ntrack_m = 0.5\nwheel_radius_m = 0.1\nmass_kg = 100.0\n'


def _export(folder: Path, header: str, words: tuple[str, str], mean: str) -> list[Path]:
    """Write a run table of six runs, with decimal commas, and a log of wheel angles in radians for each."""
    lines = ["AGV 7", "", header]
    (folder / "logs").mkdir(parents=True)
    for n in range(1, 7):
        lines.append(f"R{n};0{1 + n // 4}/05/2026;{words[n % 2]};{20 * n};{40000 + n},5;20,{n}")
        t_s, angle = np.linspace(0.0, 40.0, 300), np.linspace(0.0, 400.0, 300)
        rows = [f"{t:.3f} {a:.5f} {1.001 * a:.5f}" for t, a in zip(t_s, angle, strict=True)]
        (folder / "logs" / f"2026050{1 + n // 4}_09{n:02}_R{n}.txt").write_text("\n".join(rows) + "\n")
    lines.append(f"{mean};;;70;40004,0;20,3")
    (folder / "runs.csv").write_text("\r\n".join(lines), encoding="cp1252")
    return [folder / "runs.csv", folder / "logs"]


@pytest.mark.parametrize(
    ("header", "words", "mean"),
    [
        ("N° essai;Date;Sens;Charge utile (kg);Distance laser [mm];Température [°C]", ("aller", "retour"), "moyenne"),
        ("Ensayo;Fecha;Sentido;Carga (kg);Distancia [mm];Temperatura [°C]", ("ida", "vuelta"), "media"),
        ("Prova;Data;Verso;Carico utile (kg);Distanza [mm];Temperatura [°C]", ("andata", "ritorno"), "media"),
    ],
    ids=["French", "Spanish", "Italian"],
)
def test_an_export_goes_in_as_proposed(header: str, words: tuple[str, str], mean: str, tmp_path: Path) -> None:
    """Only what no file says is added: the vehicle and the counts that a revolution is to have."""
    sources = _export(tmp_path / "lab", header, words, mean)
    proposal = describe(sources).to_toml()
    mapping = tmp_path / "lab.toml"
    text = proposal.replace("[vehicle]", "[ignored]").replace("#counts_per_rev =", "counts_per_rev = 4096")
    mapping.write_text(text.replace("[ignored]", VEHICLE.strip(), 1), encoding="utf-8")
    ingest(sources, tmp_path / "c", mapping=mapping)
    campaign = read_campaign(tmp_path / "c")
    assert len(campaign.runs) == 6
    assert list(campaign.runs.label("direction")) == ["back", "out"] * 3
    np.testing.assert_allclose(campaign.runs.number("distance_m"), 40.0005 + 1e-3 * np.arange(1, 7))
    np.testing.assert_allclose(campaign.runs.number("payload_kg"), 20.0 * np.arange(1, 7))
    np.testing.assert_allclose(campaign.runs.number("temperature_C"), 20.0 + 0.1 * np.arange(1, 7))
    turns = campaign.logs.of(0)["counts_left"][-1] / 4096
    assert turns == pytest.approx(400.0 / (2 * np.pi), abs=1e-3)


def test_a_table_of_unknown_words_beside_logs_is_the_run_table(tmp_path: Path) -> None:
    """A row a log, with texts: names in no language that calib knows."""
    sources = _export(tmp_path / "lab", "Ajo;Pvm;Suunta;Kuorma;Matka;Lampo", ("meno", "paluu"), "ka")
    description = describe(sources)
    assert description.table is not None
    assert description.table.name.endswith("runs.csv")


@pytest.mark.parametrize(
    ("left", "right", "target"),
    [
        ("Effort roue gauche [N]", "Effort roue droite [N]", "load_{}_N"),
        ("Carga rueda izquierda [kg]", "Carga rueda derecha [kg]", "load_{}_N"),
        ("Carico ruota sx [N]", "Carico ruota dx [N]", "load_{}_N"),
        ("Load cell L [daN]", "Load cell R [daN]", "load_{}_N"),
        ("Force on wheel left [N]", "Force on wheel right [N]", "load_{}_N"),
        ("Left wheel load (lbf)", "Right wheel load (lbf)", "load_{}_N"),
        ("Radlast hinten links [kg]", "Radlast hinten rechts [kg]", "load_{}_N"),
        ("F RL (kN)", "F RR (kN)", "load_{}_N"),
        ("Wheel load HL [N]", "Wheel load HR [N]", "load_{}_N"),
        ("Turns RL", "Turns RR", "counts_{}"),
    ],
)
def test_forces_on_wheels_are_found(left: str, right: str, target: str) -> None:
    assert guessed_table_column(left) == target.format("left")
    assert guessed_table_column(right) == target.format("right")


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("Codeur gauche [imp]", "counts_left"),
        ("Codeur D", "counts_right"),
        ("Encoder izquierdo", "counts_left"),
        ("ruota_dx", "counts_right"),
        ("Counter A (left)", "counts_left"),
        ("Télémètre [mm]", "range_m"),
        ("Horodatage", "t_s"),
        ("Tempo [s]", "t_s"),
        ("cart X", "ref_x_m"),
        ("y_mocap", "ref_y_m"),
        ("Rechtswert [m]", "ref_x_m"),
        ("Hochwert [m]", "ref_y_m"),
        ("wL_rpm", "counts_left"),
        ("DriveWheel_inc", "counts_front"),
        ("Geber_v", "counts_front"),
        ("enc:battery_mV", None),
        ("servo_deg", "steer_rad"),
        ("grid", None),
        ("speed", "v_mps"),
        ("loop_time", None),
    ],
)
def test_columns_of_logs_are_found(name: str, target: str | None) -> None:
    assert guessed_log_column(name) == target


def test_a_heading_in_words_is_the_direction(tmp_path: Path) -> None:
    """Which way is out, the proposal asks."""
    (tmp_path / "t.csv").write_text(
        "trial;heading;travel [m]\n" + "".join(f"T{k};{'EW'[k % 2]};4{k}.5\n" for k in range(6))
    )
    text = describe([tmp_path / "t.csv"]).to_toml()
    assert 'direction = {column = "heading", values = {E = "out", W = "back"}}   # "out" or "back"' in text


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("Messreihe", "session"),
        ("Messkampagne", "session"),
        ("Campagne", "session"),
        ("Sessione", "session"),
        ("Jornada", "session"),
        ("Meetreeks", "session"),
        ("Afstand [m]", "distance_m"),
        ("Belasting wiel links [N]", "load_left_N"),
        ("Peso rueda derecha [N]", "load_right_N"),
        ("Lading [kg]", "payload_kg"),
        ("Snelheid", "speed_mps"),
        ("Temperatuur", "temperature_C"),
        ("Richting", "direction"),
        ("Reihe", None),
        ("Radlast vorn links [kg]", None),
        ("F FL (kN)", None),
    ],
)
def test_usual_words_of_run_tables_are_found(name: str, target: str | None) -> None:
    assert guessed_table_column(name) == target
