"""Damage inside a parquet file that its own reader does not notice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.readers import read_table
from calib.errors import BadFileError


def test_bytes_that_are_no_text_are_named_with_their_column(tmp_path: Path) -> None:
    """They are met only where the column is looked into."""
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    offsets = pa.py_buffer(np.array([0, 3], np.int32).tobytes())
    texts = pa.Array.from_buffers(pa.string(), 1, [None, offsets, pa.py_buffer(b"ab\xa8")])
    path = tmp_path / "runs.parquet"
    parquet.write_table(pa.table({"run_id": texts}), path)
    with pytest.raises(BadFileError, match="column run_id: found a damaged parquet file"):
        read_table(path, "runs.parquet")
