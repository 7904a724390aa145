"""9,500 malformed files are refused by one clear error each, or read as they stand.

Plans and JSON: ``tests/io/test_spoiled_archives.py``.
"""

from __future__ import annotations

import pytest
from examples import SHARE
from fuzzing import KINDS, tally
from promises import Keep

PARTS = 10
"""Tests of a kind, for the workers to share."""


def _share(count: int, part: int) -> range:
    size = max(1, int(SHARE * count / PARTS))
    return range(part * size, (part + 1) * size)


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("name", KINDS)
def test_malformed_files_are_refused_or_read_as_they_stand(name: str, part: int, keep: Keep) -> None:
    result = tally(name, _share(KINDS[name].count, part))
    keep("files", name, result.counts, result.classes)
    assert not result.classes, result.examples
