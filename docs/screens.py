# ruff: noqa: T201  (a script shows what it does)
"""Take the pictures of screens and pages that the site shows: ``python docs/screens.py``.

Terminal screens are taken at 80 columns from a pseudo-terminal and kept as SVG; pages of the PDF by ``pdftoppm`` (of
Debian's poppler-utils), the panels of the HTML page by a headless Chromium.
"""

from __future__ import annotations

import argparse
import io
import os
import pty
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "pictures"
COLUMNS = 80
CALIB = [sys.executable, "-m", "calib"]
#: picture -> command, and how many lines of it are shown
SCREENS: Mapping[str, tuple[str, int]] = {
    "screen-check": ("check sample_runs/corridor", 40),
    "screen-fit": ("fit sample_runs/corridor_crossed", 34),
    "screen-diagnose": ("diagnose sample_runs/yard", 40),
    "screen-effects": ("effects track_width", 40),
}
PAGES = ("1", "4")
SAMPLE, PANELS = "sample_runs/corridor_crossed", "sample_runs/yard"
#: the window, and what of it the panels fill
WINDOW = (1250, 1180)


def screen(command: str) -> str:
    """Return what a command prints on a terminal of 80 columns, colours included."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "COLUMNS": str(COLUMNS), "TERM": "xterm-256color", "PYTHONPATH": str(ROOT)}
    running = subprocess.Popen(
        [*CALIB, *command.split()], cwd=ROOT, env=environment, stdout=theirs, stderr=subprocess.DEVNULL
    )
    os.close(theirs)
    taken = b""
    while True:
        try:
            data = os.read(ours, 65536)
        except OSError:
            # the other end is closed
            break
        if not data:
            break
        taken += data
    running.wait()
    return taken.decode().replace("\r\n", "\n")


def drawn(command: str, text: str, lines: int) -> str:
    """Return a screen as SVG that fetches no font."""
    from rich.console import Console
    from rich.text import Text

    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    console.print(f"[bold]$[/bold] calib {command}", highlight=False)
    shown = text.rstrip().split("\n")
    console.print(Text.from_ansi("\n".join(shown[:lines])))
    if len(shown) > lines:
        console.print(f"[dim]... {len(shown) - lines} lines more[/dim]", highlight=False)
    picture = console.export_svg(title="calib", unique_id="calib")
    return re.sub(r"@font-face \{.*?\}\s*", "", picture, flags=re.DOTALL)


def pages(folder: Path) -> None:
    """Take pages of the report and the panels of its HTML page."""
    pdf, html = folder / "report.pdf", folder / "page.html"
    common = ["--date", "2025-03-31", "--force"]
    subprocess.run([*CALIB, "report", SAMPLE, "--into", str(pdf), *common], cwd=ROOT, check=True)
    for page in PAGES:
        target = FOLDER / f"report-page-{page}"
        command = ["pdftoppm", "-r", "72", "-png", "-singlefile", "-f", page, "-l", page, str(pdf), str(target)]
        subprocess.run(command, check=True)
    subprocess.run([*CALIB, "diagnose", PANELS, "--html", str(html), "--force"], cwd=ROOT, check=False)
    # the panels alone: what stands above them is the report's own words
    text = html.read_text(encoding="utf-8").replace("<main>", '<main style="max-width:none">', 1)
    text = re.sub(r'<section id="s\d+">.*?</section>|<header>.*?</header>|<nav>.*?</nav>', "", text, flags=re.DOTALL)
    html.write_text(text, encoding="utf-8")
    browser = shutil.which("chromium") or "chromium-browser"
    flags = "--headless --no-sandbox --disable-gpu --hide-scrollbars --virtual-time-budget=15000"
    size = f"--window-size={WINDOW[0]},{WINDOW[1]}"
    subprocess.run(
        [browser, *flags.split(), size, f"--screenshot={FOLDER / 'panels.png'}", html.as_uri()],
        check=True,
        capture_output=True,
    )


def main() -> int:
    """Take all pictures, or the screens alone."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--screens", action="store_true", help="the terminal's screens alone")
    given = parser.parse_args()
    for name, (command, lines) in SCREENS.items():
        print(f"$ calib {command}", file=sys.stderr, flush=True)
        (FOLDER / f"{name}.svg").write_text(drawn(command, screen(command), lines), encoding="utf-8")
    if not given.screens:
        with TemporaryDirectory() as folder:
            pages(Path(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
