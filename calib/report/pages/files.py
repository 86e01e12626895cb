"""The files behind the report, by their hashes."""

from __future__ import annotations

import hashlib
from typing import Final

from calib import __version__
from calib.report.blocks import Block, Column, Facts, Section, Table, Text
from calib.report.numbers import left
from calib.report.source import Source

#: beyond this many files their logs are given as one hash
MOST_FILES: Final = 12


def section(source: Source) -> Section:
    """Return the inputs with their SHA-256, the program and the attachment."""
    inputs = source.inputs
    named = {path: digest for path, digest in inputs.items() if not path.startswith("logs/")}
    others = {path: digest for path, digest in inputs.items() if path not in named}
    if len(inputs) <= MOST_FILES:
        named, others = dict(inputs), {}
    rows = sorted(named.items())
    if others:
        listing = "".join(f"{digest}  {path}\n" for path, digest in sorted(others.items()))
        rows.append((f"{len(others)} logs*", hashlib.sha256(listing.encode()).hexdigest()))
    blocks: list[Block] = [
        Facts(
            (
                ("Program", f"calib {source.fit.provenance.get('version', __version__)}"),
                ("Attached", "coefficients.json"),
                ("Its checksum", source.coefficients.checksum),
            )
        )
    ]
    if rows:
        blocks.append(
            Table(
                "Input files and their SHA-256.",
                (left("File", wide=True), Column("SHA-256", align="left", mono=True)),
                tuple(rows),
                dense=True,
            )
        )
    else:
        blocks.append(Text("The data were handed over in memory; there are no input files."))
    if others:
        blocks.append(
            Text(
                "* SHA-256 of the list that sha256sum prints for the logs, sorted by path; each log's own stands in "
                "the attached coefficients.json.",
                small=True,
            )
        )
    return Section("Files", tuple(blocks))
