"""The PDF: valid, archivable, the same bytes, and every text set literally."""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest
import typst

from calib.coefficients.file import load_coefficients
from calib.documents import to_json
from calib.reporting import Column, Facts, Items, Notice, Section, Table, Text, pages
from calib.reporting.content import Report, compose
from calib.reporting.figures import FORMS, write_figures
from calib.reporting.pages import to_pdf
from calib.reporting.source import STATED, Source

HOSTILE = '#panic("x") $a^b$ *bold* _it_ @ref <lab> `raw` \\ \\u{41} // /* ~ [b] = h -- ... \'q\' #let " {{}} ümläut λ'


def streams(pdf: bytes) -> list[bytes]:
    """All streams of a PDF, inflated where they are deflated."""
    made = []
    for match in re.finditer(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.S):
        try:
            made.append(zlib.decompress(match.group(1)))
        except zlib.error:
            made.append(match.group(1))
    return made


def test_it_is_a_pdf_a_3_with_the_coefficients_attached(pdf: bytes, source: Source, tmp_path: Path) -> None:
    assert pdf.startswith(b"%PDF-1.7")
    assert pdf.rstrip().endswith(b"%%EOF")
    everything = pdf + b"".join(streams(pdf))
    assert re.search(rb"pdfaid:part(>|=\")3", everything)
    assert b"/AFRelationship" in everything
    assert b"coefficients.json" in everything
    attached = source.coefficients.to_bytes()
    assert attached in everything
    # what a customer detaches is the coefficient file itself, schema and checksum included
    (tmp_path / "coefficients.json").write_bytes(next(one for one in streams(pdf) if one == attached))
    assert load_coefficients(tmp_path / "coefficients.json").checksum == source.coefficients.checksum


def test_the_pages_are_as_many_as_counted(pdf: bytes) -> None:
    everything = pdf + b"\n".join(streams(pdf))
    pages = len(re.findall(rb"/Type\s*/Page\b(?!s)", everything))
    counted = max(int(number) for number in re.findall(rb"/Type\s*/Pages\s*/Count\s+(\d+)", everything))
    assert pages == counted
    assert 5 <= pages <= 10


def test_same_input_and_date_give_the_same_bytes(pdf: bytes, source: Source) -> None:
    """Composed, drawn and set anew."""
    assert to_pdf(compose(source)) == pdf


@pytest.mark.usefixtures("undrawn")
def test_another_date_changes_the_bytes_and_stands_in_the_document(report: Report, pdf: bytes) -> None:
    later = to_pdf(replace(report, issued="2026-04-01"))
    assert b"D:20250331" in pdf and b"D:20260401" not in pdf
    assert b"D:20260401" in later and b"D:20250331" not in later


def test_figures_are_vectors(pdf: bytes) -> None:
    assert b"/Subtype/Image" not in re.sub(rb"\s", b"", pdf + b"".join(streams(pdf)))


def hostile(report: Report) -> Report:
    table = Table(HOSTILE, (Column(HOSTILE, align="left", wide=True), Column("n", HOSTILE)), ((HOSTILE, HOSTILE),))
    blocks = (Text(HOSTILE), Facts(((HOSTILE, HOSTILE),)), Items((HOSTILE,)), Notice("bad", HOSTILE, HOSTILE), table)
    stated = dict.fromkeys(STATED, HOSTILE)
    return replace(
        report, name=HOSTILE, stated=stated, facts=((HOSTILE, HOSTILE),), sections=(Section(HOSTILE, blocks),)
    )


def test_markup_in_names_is_set_literally(report: Report, tmp_path: Path) -> None:
    """The page's heading holds the text as one literal; nothing of it is read as markup or run."""
    made = hostile(report)
    assert to_pdf(made).startswith(b"%PDF")
    (tmp_path / "main.typ").write_bytes((files("calib.reporting") / "page.typ").read_bytes())
    (tmp_path / "data.json").write_text(to_json(made.to_dict()), encoding="utf-8")
    (tmp_path / "coefficients.json").write_bytes(made.attachments[0].data)
    found = json.loads(typst.query(str(tmp_path / "main.typ"), "heading", root=str(tmp_path)))
    assert [one["body"] for one in found] == [{"func": "text", "text": HOSTILE}]
    captions = json.loads(typst.query(str(tmp_path / "main.typ"), "figure", root=str(tmp_path)))
    assert captions[0]["caption"]["body"] == {"func": "text", "text": HOSTILE}


def texts_in(value: object) -> list[str]:
    """All texts of what a query gives."""
    if isinstance(value, dict):
        inner = [text for part in value.values() for text in texts_in(part)]
        return [value["text"], *inner] if isinstance(value.get("text"), str) else inner
    return [text for part in value for text in texts_in(part)] if isinstance(value, list) else []


def test_long_names_may_break_but_hashes_stay_whole(report: Report, tmp_path: Path) -> None:
    """A run id without a blank is set in pieces; a hash can be copied from the page as it is."""
    name, digest = "run_" + "x" * 60, "sha256:" + "0123456789abcdef" * 4
    table = Table("c", (Column("a"), Column("b")), ((name, digest),))
    made = replace(report, name="n", sections=(Section("s", (table,)),))
    (tmp_path / "main.typ").write_bytes((files("calib.reporting") / "page.typ").read_bytes())
    (tmp_path / "data.json").write_text(to_json(made.to_dict()), encoding="utf-8")
    (tmp_path / "coefficients.json").write_bytes(made.attachments[0].data)
    found = texts_in(json.loads(typst.query(str(tmp_path / "main.typ"), "figure", root=str(tmp_path))))
    assert digest in found
    pieces = next(text for text in found if text.replace("\u200b", "") == name).split("\u200b")
    assert max(map(len, pieces)) <= 10


def test_the_page_is_set_without_a_warning(report: Report, tmp_path: Path) -> None:
    """No missing font, no missing glyph, nothing that does not converge."""
    (tmp_path / "main.typ").write_bytes((files("calib.reporting") / "page.typ").read_bytes())
    blank = b'<svg xmlns="http://www.w3.org/2000/svg" width="10" height="5"/>'
    for picture in report.pictures:
        (tmp_path / f"{picture.name}.svg").write_bytes(blank)
    (tmp_path / "data.json").write_text(to_json(report.to_dict()), encoding="utf-8")
    (tmp_path / "coefficients.json").write_bytes(report.attachments[0].data)
    compiler = typst.Compiler(str(tmp_path / "main.typ"), root=str(tmp_path), ignore_system_fonts=True)
    _, warnings = compiler.compile_with_warnings(format="pdf")
    assert [str(one) for one in warnings] == []


def test_measured_data_carry_no_mark(measured: Source, pdf: bytes) -> None:
    """The subject of the document says simulated exactly where the data are."""
    everything = pdf + b"".join(streams(pdf))
    assert b"simulated data" in everything
    assert b"simulated data" not in to_pdf(replace(compose(measured), sections=()))


def test_every_figure_is_had_as_png_svg_and_pdf(report: Report, tmp_path: Path) -> None:
    report = replace(report, sections=(Section("Figures", report.pictures[:1]),))
    written = write_figures(report.figures(), tmp_path / "figures")
    assert len(written) == len(FORMS)
    starts = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
    for path in written:
        assert path.read_bytes().startswith(starts[path.suffix])
    from calib.errors import CalibError

    with pytest.raises(CalibError, match="force=True"):
        write_figures(report.figures(), tmp_path / "figures")


def test_only_signs_without_a_font_are_replaced(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of a kind that the page has no font for takes its kind with it, and nothing else."""
    (tmp_path / "data.json").write_text("20 °C, セッション, № 3", encoding="utf-8")

    def compiled(folder: Path, _: Report, *, system_fonts: bool) -> bytes:
        text = (folder / "data.json").read_text(encoding="utf-8")
        if "セ" in text:
            raise pages._MissingSign("セ" if system_fonts else "°")
        return text.encode()

    monkeypatch.setattr(pages, "_compiled", compiled)
    text = pages._compile_with_fallback(tmp_path, report).decode()
    assert "20 °C" in text
    assert "№ 3" in text
    assert "[U+30BB][U+30C3]" in text


def test_no_row_of_a_table_breaks_across_pages(report: Report, tmp_path: Path) -> None:
    """Rows of many lines each: first and last word of a row stand on one page."""
    cells = [(" ".join(["FIRSTWORD", *["word"] * 110, "LASTWORD"]), "1") for _ in range(24)]
    table = Table("c", (Column("a", align="left", wide=True), Column("b")), tuple(cells))
    made = replace(report, name="n", sections=(Section("s", (table,)),))
    marks = "".join(f'#show "{word}": it => [#it#metadata(none)<{word}>]\n' for word in ("FIRSTWORD", "LASTWORD"))
    pages = "".join(
        f"#context [#metadata(query(<{word}>).map(one => one.location().page()))<pages>]\n"
        for word in ("FIRSTWORD", "LASTWORD")
    )
    page = (files("calib.reporting") / "page.typ").read_text(encoding="utf-8")
    (tmp_path / "main.typ").write_text(f"{marks}{page}\n{pages}", encoding="utf-8")
    (tmp_path / "data.json").write_text(to_json(made.to_dict()), encoding="utf-8")
    (tmp_path / "coefficients.json").write_bytes(made.attachments[0].data)
    first, last = json.loads(typst.query(str(tmp_path / "main.typ"), "<pages>", field="value", root=str(tmp_path)))
    assert first == last and len(first) == 24 and len(set(first)) > 2
