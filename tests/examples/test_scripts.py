"""Scripts of the documents run as they stand, with their own numbers of samples."""

from __future__ import annotations

import runpy
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).resolve().parents[2] / "docs" / "examples").glob("*.py"))
OF_OTHERS = {"cassie_leg", "cassie_squat", "solo_feet", "solo_squat"}
"""Those that need example-robot-data."""


@pytest.mark.parametrize("script", [pytest.param(path, id=path.stem) for path in SCRIPTS])
def test_a_script_runs(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if script.stem in OF_OTHERS:
        try:
            version("example-robot-data")
        except PackageNotFoundError:
            pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(script.parent))
    monkeypatch.setattr("sys.argv", [str(script)])
    runpy.run_path(str(script), run_name="__main__")
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) > 1
    assert "nan" not in printed
