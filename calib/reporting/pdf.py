"""The report as PDF/A-3: figures drawn, page set, coefficient file attached; same input, same bytes."""

from __future__ import annotations

import re
import unicodedata
from contextlib import suppress
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from calib.documents import to_json
from calib.errors import CalibError
from calib.reporting.content import Report
from calib.reporting.figures.style import render
from calib.types import Progress, silent, stepped

#: PDF/A-3 at its accessible level: tagged, with alternative texts
STANDARD: Final = "a-3a"
#: missing signs replaced one by one, beyond whole scripts that the fonts lack
MAX_MISSING_SIGNS: Final = 24


def to_pdf(report: Report, progress: Progress = silent) -> bytes:
    """Return the report as PDF/A-3a.

    The same for the same report: its date is the date of issue, and only built-in fonts are used, unless a name holds
    signs that these lack. Raises CalibError where the page cannot be set.
    """
    sources: dict[str, bytes] = {
        "main.typ": (files("calib.reporting") / "page.typ").read_bytes(),
        "data.json": to_json(report.to_dict()).encode("utf-8"),
    }
    for picture in stepped(report.pictures, progress, "figures of the PDF"):
        sources[f"{picture.name}.svg"] = render(picture.draw(), "svg")
    for attachment in report.attachments:
        sources[attachment.name] = attachment.data
    if report.logo is not None:
        sources |= dict([report.logo])
    with TemporaryDirectory(prefix="calib-report-") as folder:
        for name, data in sources.items():
            (Path(folder) / name).write_bytes(data)
        return _compile_with_fallback(Path(folder), report)


def _compile_with_fallback(folder: Path, report: Report) -> bytes:
    """Set the page with the built-in fonts.

    Where a sign is in none of them, those of the system are used, too; where it is in none of these either, it is
    replaced by its code point.
    """
    text = (folder / "data.json").read_text(encoding="utf-8")
    with suppress(_MissingSign):
        return _compiled(folder, report, system_fonts=False)
    for _ in range(MAX_MISSING_SIGNS):
        try:
            return _compiled(folder, report, system_fonts=True)
        except _MissingSign as error:
            for sign in {sign for sign in text if _of_rare_script(sign)} | set(str(error)):
                text = text.replace(sign, f"[U+{ord(sign):X}]")
            (folder / "data.json").write_text(text, encoding="utf-8")
    raise CalibError("the report's page cannot be set: too many signs that no font has; expected common scripts")


def _of_rare_script(sign: str) -> bool:
    """Return whether a sign is of a script that the built-in fonts lack as a whole."""
    common = unicodedata.name(sign, "").startswith(("LATIN", "GREEK", "CYRILLIC"))
    return unicodedata.category(sign) in {"Lo", "So", "Cn", "Co"} and not common


class _MissingSign(Exception):
    """Signs that no font has."""


def _compiled(folder: Path, report: Report, *, system_fonts: bool) -> bytes:
    import typst

    try:
        compiled = typst.compile(
            str(folder / "main.typ"),
            root=str(folder),
            format="pdf",
            pdf_standards=[STANDARD],
            ignore_system_fonts=not system_fonts,
            timestamp=datetime.fromisoformat(report.issued).replace(tzinfo=UTC),
        )
    except RuntimeError as error:
        missing = re.search(r'the text `"(.+?)"` could not be displayed', str(error))
        if missing:
            raise _MissingSign(missing[1]) from error
        if report.logo is not None and re.search(r"image|svg", str(error), re.IGNORECASE):
            raise CalibError(
                f"campaign.toml, report.logo: found a file that cannot be drawn ({error}); expected a picture as its "
                "name says; save it again as SVG, PNG or JPEG"
            ) from error
        raise CalibError(
            f"the report's page cannot be set: {error}; expected a page for any content, so please report it"
        ) from error
    return bytes(compiled)
