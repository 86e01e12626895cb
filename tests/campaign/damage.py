"""A seeded damager: spoils a sound campaign in one of many ways that labs and disks know."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

Damage = Callable[[Path, np.random.Generator], None]


def _any(folder: Path, rng: np.random.Generator) -> Path:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return files[0] if rng.random() < 0.25 else files[-1] if rng.random() < 0.4 else files[rng.integers(len(files))]


def _csv(folder: Path, rng: np.random.Generator) -> Path:
    files = [folder / "runs.csv", *sorted((folder / "logs").glob("*.csv"))]
    return files[rng.integers(len(files))] if rng.random() < 0.5 else files[0]


def cut(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    data = path.read_bytes()
    path.write_bytes(data[: rng.integers(len(data))])


def empty(folder: Path, rng: np.random.Generator) -> None:
    _any(folder, rng).write_bytes(b"")


def only_header(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    path.write_bytes(path.read_bytes().split(b"\n")[0] + b"\n")


def flip_bytes(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    data = bytearray(path.read_bytes())
    for at in rng.integers(len(data), size=rng.integers(1, 30)):
        data[at] = rng.integers(256)
    path.write_bytes(bytes(data))


def noise(folder: Path, rng: np.random.Generator) -> None:
    _any(folder, rng).write_bytes(rng.bytes(int(rng.integers(1, 5000))))


def nul_bytes(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    data = path.read_bytes()
    at = int(rng.integers(len(data)))
    path.write_bytes(data[:at] + b"\0" * int(rng.integers(1, 4000)) + data[at:])


def cell(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    row = rows[rng.integers(1, len(rows))]
    spoilt = [
        "nan",
        "NaN",
        "inf",
        "-inf",
        "1e999",
        "abc",
        "",
        "1;2",
        '"',
        "=1+1",
        "1_0",
        "0x1f",
        "9" * 400,
        "-0",
        "true",
    ]
    spoilt += ["1,5", "1.2.3", "--1", "1e308", "-1e308", "\ud7ff", "'; drop", "9" * 200000, "1 2", "NULL", "٣", "\x07"]
    spoilt += ["true"]
    row[rng.integers(len(row))] = spoilt[rng.integers(len(spoilt))]
    path.write_text("\n".join(",".join(cells) for cells in rows) + "\n", encoding="utf-8")


def column_of(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    at = rng.integers(len(rows[0]))
    for cells in rows[1:]:
        cells[at] = ["nan", "x", "1e300", "-1", "0"][rng.integers(5)]
    path.write_text("\n".join(",".join(cells) for cells in rows))


def swap_columns(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    head, _, rest = path.read_text().partition("\n")
    names = head.split(",")
    one, two = rng.choice(len(names), 2, replace=False)
    names[one], names[two] = names[two], names[one]
    path.write_text(",".join(names) + "\n" + rest)


def header(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    head, _, rest = path.read_text().partition("\n")
    names = head.split(",")
    at, other = rng.choice(len(names), 2, replace=False)
    names[at] = ["", names[other], names[at].upper(), f'"{names[at]}', names[at] + "_mm", "x" * 5000][rng.integers(6)]
    path.write_text(",".join(names) + "\n" + rest)


def drop_column(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    at = rng.integers(len(rows[0]))
    path.write_text("\n".join(",".join(cells[:at] + cells[at + 1 :]) for cells in rows))


def ragged(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    lines = path.read_text().splitlines()
    at = rng.integers(1, len(lines))
    lines[at] = [lines[at] + ",1,2,3", lines[at].rpartition(",")[0], lines[at].replace(",", ";"), "", ",,,,"][
        rng.integers(5)
    ]
    path.write_text("\n".join(lines))


def encoding(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    text = path.read_text()
    kind = ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-7", "cp037"][rng.integers(6)]
    path.write_bytes(text.encode(kind))


def line_ends(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    path.write_bytes(path.read_bytes().replace(b"\n", [b"\r", b"\r\n", b"\n\n", b" ", b"\v"][rng.integers(5)]))


def decimal_comma(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    text = path.read_text()
    path.write_text(text.replace(".", ",") if rng.random() < 0.5 else text.replace(",", ";").replace(".", ","))


def log_path(folder: Path, rng: np.random.Generator) -> None:
    path = folder / "runs.csv"
    lines = path.read_text().splitlines()
    at = rng.integers(1, len(lines))
    targets = ["../../../etc/passwd", "/etc/passwd", "/dev/zero", "logs", ".", "..", "runs.csv", "nothing.csv", "a\0b"]
    targets += [
        "~/x.csv",
        "logs/" + "x" * 5000 + ".csv",
        "file:///etc/passwd",
        "logs/r000.exe",
        "\\\\host\\x.csv",
        "logs/r000.csv",
    ]
    lines[at] = lines[at].rpartition(",")[0] + "," + targets[rng.integers(len(targets))]
    path.write_text("\n".join(lines) + "\n")


def link(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    path.unlink()
    path.symlink_to(["/etc/passwd", "/dev/zero", path, path.parent, "/nonexistent", folder.parent][rng.integers(6)])


def folder_for_file(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    path.unlink()
    path.mkdir()


def missing(folder: Path, rng: np.random.Generator) -> None:
    if rng.random() < 0.3:
        shutil.rmtree(folder / "logs")
    else:
        _any(folder, rng).unlink()


def duplicate_rows(folder: Path, rng: np.random.Generator) -> None:
    path = _csv(folder, rng)
    lines = path.read_text().splitlines()
    at = rng.integers(1, len(lines))
    path.write_text("\n".join([*lines[:at], *[lines[at]] * 5, *lines[at:]]))


def settings_value(folder: Path, rng: np.random.Generator) -> None:
    path = folder / "campaign.toml"
    lines = path.read_text().splitlines()
    places = [number for number, line in enumerate(lines) if "=" in line]
    at = places[rng.integers(len(places))]
    spoilt = [
        '"x"',
        "true",
        "nan",
        "inf",
        "-1",
        "0",
        "1e308",
        "[]",
        "{}",
        "1979-05-27",
        "1" + "0" * 400,
        '"""',
        "1e-320",
        "",
    ]
    spoilt += ["1e-320"]
    lines[at] = lines[at].partition("=")[0] + "= " + spoilt[rng.integers(len(spoilt))]
    path.write_text("\n".join(lines))


def settings_shape(folder: Path, rng: np.random.Generator) -> None:
    path = folder / "campaign.toml"
    text = path.read_text()
    section = ["vehicle", "encoder", "model", "rangefinder", "reference"][rng.integers(5)]
    spoilt = [
        text.replace(f"[{section}]", f"[[{section}]]"),
        f"{section} = 3\n" + text.replace(f"[{section}]", "[other]"),
        text.replace("calib-campaign/1", "calib-campaign/9"),
        text + text,
        text.replace("[", "", 1),
        "a = " + "[" * 100000,
        text.replace(f"[{section}]", ""),
        text.replace("=", ":"),
        "\n".join(f"k{i} = {i}" for i in range(20000)) + "\n" + text,
    ]
    path.write_text(spoilt[rng.integers(len(spoilt))])


def promise(folder: Path, rng: np.random.Generator) -> None:
    """A billion rows: in a workbook's dimension and row numbers, in a parquet footer, or in the settings."""
    kind = rng.integers(4)
    if kind == 0:
        path = folder / "campaign.toml"
        path.write_text("rows = 1000000000\n" + path.read_text())
        return
    (folder / "runs.csv").unlink()
    if kind == 1:
        (folder / "runs.parquet").write_bytes(b"PAR1" + rng.bytes(200) + (10**9).to_bytes(4, "little") + b"PAR1")
    elif kind == 2:
        (folder / "runs.xlsx").write_bytes(b"PK\x03\x04" + rng.bytes(300))
    else:
        _promising_workbook(folder / "runs.xlsx")


def _promising_workbook(path: Path) -> None:
    import zipfile

    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["run_id", "distance_m"])
    book.active.append(["a", 40.0])
    book.save(path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    sheet = "xl/worksheets/sheet1.xml"
    parts[sheet] = parts[sheet].replace(b'r="2"', b'r="1000000000"').replace(b'"A1:B2"', b'"A1:B1000000000"')
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)


def one_line(folder: Path, rng: np.random.Generator) -> None:
    path = _any(folder, rng)
    path.write_bytes(
        [b",", b"\n", b"\xff\xfe", b"\xef\xbb\xbf", b",,,,\n,,,,\n", b'"', b"x" * 300000, b"\x00"][rng.integers(8)]
    )


DAMAGES: dict[str, Damage] = {
    made.__name__: made
    for made in (
        cut,
        empty,
        only_header,
        flip_bytes,
        noise,
        nul_bytes,
        cell,
        column_of,
        swap_columns,
        header,
        drop_column,
        ragged,
        encoding,
        line_ends,
        decimal_comma,
        log_path,
        link,
        folder_for_file,
        missing,
        duplicate_rows,
        settings_value,
        settings_shape,
        promise,
        one_line,
    )
}
