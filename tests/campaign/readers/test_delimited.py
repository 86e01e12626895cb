"""Small tables of nothing but numbers are read by numpy; what it reads is what pandas reads, and the rest is left."""

from __future__ import annotations

import io

import numpy as np
import pytest

from calib.campaign.readers.delimited import SMALL, _plain


def table(rows: list[list[str]], delimiter: str = ",") -> bytes:
    return "".join(delimiter.join(row) + "\n" for row in rows).encode()


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_numbers_are_what_pandas_reads(delimiter: str) -> None:
    """Counts, decimals of any length, signs and exponents."""
    pd = pytest.importorskip("pandas")
    rng = np.random.default_rng(3)
    rows = [[f"{k}", f"{value:.17g}", f"{value:+.3e}", f"{-k}."] for k, value in enumerate(rng.normal(size=200) * 1e3)]
    body = table(rows, delimiter)
    values = _plain(body, len(rows), 4, delimiter)
    assert values is not None
    expected = pd.read_csv(io.BytesIO(body), header=None, sep=delimiter).to_numpy(np.float64)
    # pandas parses seventeen digits to within one unit in the last place
    np.testing.assert_allclose(values, expected, rtol=3e-16, atol=0.0)


@pytest.mark.parametrize("cell", ["", "-", "nan", " 1", "1_0", "0x1", "1e", "1.2.3", "inf", '"1"', "1,5", "#"])
def test_anything_but_a_number_is_left_to_the_careful(cell: str) -> None:
    assert _plain(table([["1", "2"], ["3", cell]], ";"), 2, 2, ";") is None


def test_a_blank_or_a_short_row_is_left_to_the_careful() -> None:
    assert _plain(b"1,2\n\n3,4\n", 3, 2, ",") is None
    assert _plain(b"1,2\n3\n", 2, 2, ",") is None


def test_a_large_table_is_left_to_pandas() -> None:
    rows = [["1", "2"]] * (SMALL // 4 + 1)
    assert _plain(table(rows), len(rows), 2, ",") is None
    assert _plain(table(rows[1:]), len(rows) - 1, 2, ",") is not None
