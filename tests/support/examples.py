"""How many random examples a property is tried on: ``make long`` asks for ten times as many as ``make test``."""

from __future__ import annotations

import os
from typing import Any

from hypothesis import settings

FACTOR = int(os.environ.get("EXAMPLES", "1"))
"""Multiplies every number of random cases."""


def examples(count: int, **options: Any) -> settings:
    """Return hypothesis's settings for a property: ``count`` examples in ``make test``, and no deadline."""
    return settings(max_examples=count * FACTOR, deadline=None, **options)


SHARE = float(os.environ.get("SHARE", "1"))
"""Of the long lists of malformed inputs and random problems: ``SHARE=0.01 pytest -m long tests/fuzz`` tries a few."""
