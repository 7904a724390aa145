"""One table in four forms."""

from __future__ import annotations

import json
import math

import numpy as np

from redundancy_pin.io.json_data import json_data
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis.table import Table, span, table, text

TABLE = Table(("name", "tau", "file"), ("name", "|torque|", "file"), (("a|b", "1.00, –", "[run](a.csv)"),), "title")


def test_markdown_escapes_bars() -> None:
    assert TABLE.markdown().splitlines() == [
        "| name | \\|torque\\| | file |",
        "| --- | --- | --- |",
        "| a\\|b | 1.00, – | [run](a.csv) |",
    ]
    assert TABLE.only("file").rows == (("[run](a.csv)",),)


def test_a_terminal_shows_the_text_of_links() -> None:
    assert [list(column.cells) for column in TABLE.terminal().columns] == [["a|b"], ["1.00, –"], ["run"]]


def test_cells_show_numbers_that_do_not_exist() -> None:
    assert text((1.0, math.nan), ".2f") == "1.00, –"
    assert [text(value) for value in (math.inf, True, np.bool_(False), None)] == ["unbounded", "yes", "no", "–"]


def test_json_has_no_number_that_does_not_exist() -> None:
    data = json_data({"a": math.nan, "b": (np.float64(1.0), math.inf), "c": ResultStatus.OK, "d": np.arange(2)})
    assert json.loads(json.dumps(data, allow_nan=False)) == {
        "a": None,
        "b": [1.0, None],
        "c": "ok",
        "d": [0, 1],
    }


def test_ranges_are_of_the_numbers_that_exist() -> None:
    assert span([2.0, math.nan, 1.0]) == "1 to 2"
    assert span([1.0, 1.0001]) == "1"
    assert span([math.nan]) == text(None) == "–"


def test_the_columns_of_the_report_are_entries_of_records() -> None:
    record = {"effort_limit": math.inf, "fastest_with_plan": {"speed": 1.25}, "slowest_without": None}
    fastest = table("fastest", [record])
    shown = dict(zip(fastest.headings, fastest.rows[0], strict=True))
    assert shown["limit of main forces [N]"] == "none"
    assert shown["fastest with a plan [m/s]"] == "1.250"
    assert shown["slowest without [m/s]"] == "–"
