"""One thread for linear algebra, where the work is many small matrices."""

from __future__ import annotations

import os

#: read by OpenMP, OpenBLAS and MKL when numpy is first imported
SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_blas_thread() -> None:
    """Keep numpy's linear algebra to one thread, unless the user's environment says otherwise.

    A diagnosis factors thousands of matrices of a few dozen rows: handing each to threads costs more than it saves. To
    be called before numpy is imported; afterwards it does nothing.
    """
    for name in SETTINGS:
        os.environ.setdefault(name, "1")
