"""A computed map in files."""

from __future__ import annotations

import json
from pathlib import Path

from redundancy_pin.errors import OutputError
from redundancy_pin.experiments.feasibility.pictured import draw
from redundancy_pin.experiments.feasibility.result import FeasibilityMap
from redundancy_pin.io.files import replacing_file, write_text
from redundancy_pin.visualisation.figures.style import save

FILES = ("map.csv", "map.json", "map.svg", "map.png")
"""What is written beside the journal."""

JOURNAL = "journal.jsonl"


def write_map(found: FeasibilityMap, folder: str | Path, *, pictures: bool = True) -> tuple[Path, ...]:
    """Write a map into a folder: all cells as CSV and JSON, the picture as SVG and PNG; each whole or not at all.

    Args:
        found: the map.
        folder: made if it is missing; other files in it are left alone.
        pictures: whether to draw.

    Raises:
        OutputError: a file cannot be written.
        RedundancyPinError: pictures without matplotlib.
    """
    place = make_folder(folder)
    drawn = draw(found) if pictures else None
    write_text(place / "map.csv", found.csv())
    write_text(place / "map.json", json.dumps(found.as_dict(), indent=1, allow_nan=False) + "\n")
    if drawn is None:
        return place / "map.csv", place / "map.json"
    for name in ("map.svg", "map.png"):
        with replacing_file(place / name) as temporary:
            save(drawn, temporary)
    return tuple(place / name for name in FILES)


def make_folder(folder: str | Path) -> Path:
    """Return a folder that exists.

    Raises:
        OutputError: it cannot be made, or is a file.
    """
    place = Path(folder).expanduser()
    try:
        place.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot make the folder {place}: {error.strerror or error}.", remedy="Choose another.", path=str(place)
        ) from error
    return place
