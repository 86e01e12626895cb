"""How far a test looks: few examples in the suite, many under ``HYPOTHESIS_PROFILE=explore``."""

from __future__ import annotations

import os

#: whether to look further
EXPLORES = os.environ.get("HYPOTHESIS_PROFILE") == "explore"
