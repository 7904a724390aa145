"""Work on strangers' files in a child process: it has no more memory than it may."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.io.limited import run_limited


def test_a_child_has_no_more_memory_than_it_may_and_what_it_prints_is_no_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "child.py").write_text(
        "import os\nfrom redundancy_pin.io.limited import answer\n"
        "answer(lambda size: os.write(1, b'printed') and bytes(int(size))[:3])\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    assert run_limited("child", ["1000"], "model.xml") == b"\0\0\0"
    with pytest.raises(RedundancyPinError, match=r"3000 MB.*exit code 1"):
        run_limited("child", [str(4 << 30)], "model.xml")
