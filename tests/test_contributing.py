"""The page for contributors is right: what it names is there, and folders are no larger than a reader can hold."""

from __future__ import annotations

import re
from pathlib import Path

import redundancy_pin

PACKAGE = Path(redundancy_pin.__file__).parent
PAGE = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
MOST_MODULES = 20


def test_the_walks_lead_through_functions_that_are_there() -> None:
    walks = PAGE.partition("Three walks")[2].partition("Where new things go")[0]
    stops = re.findall(r"`([a-z_/]+\.py)`\s+((?:`\w+`(?:,\s+)?)+)", walks)
    assert len(stops) > 15
    for file, names in stops:
        text = (PACKAGE / file).read_text(encoding="utf-8")
        for name in re.findall(r"\w+", names):
            assert re.search(rf"(def|class) {name}\b", text), f"{file} has no {name}"


def test_every_room_of_the_table_is_there_and_every_room_is_in_it() -> None:
    rows = re.findall(r"^\| (`.*?) \|", PAGE.partition("| room |")[2].partition("Three walls")[0], re.MULTILINE)
    named = {name.rstrip("/") for row in rows for name in re.findall(r"`([a-z_/.]+)`", row)}
    own = {"__init__.py", "_moved.py", "_startup.py", "py.typed", "__pycache__", "models"}
    assert named == {path.name for path in PACKAGE.iterdir()} - own


def test_no_folder_has_more_modules_than_a_reader_can_hold() -> None:
    for folder in (PACKAGE, *(path for path in PACKAGE.rglob("*") if path.is_dir())):
        assert len(list(folder.glob("*.py"))) <= MOST_MODULES, folder
