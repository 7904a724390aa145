"""One table in four forms."""

from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
from rich.console import Console

from redundancy_pin.io.json_data import json_data
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.table import Column, Link, Table, csv_text, span, table, text

TABLE = Table.of(
    [Column("name"), Column("tau", "|torque|", "N·m", ".2f"), Column("good"),
     Column("file", value=lambda r: Link("run", "a.csv"))],
    [{"name": "a|b", "tau": (1.0, math.nan), "good": True}, {"name": "c", "tau": math.inf, "good": np.bool_(False)}],
    "title",
)  # fmt: skip


def test_markdown() -> None:
    assert TABLE.markdown().splitlines() == [
        "| name | \\|torque\\| [N·m] | good | file |",
        "| --- | --- | --- | --- |",
        "| a\\|b | 1.00, – | yes | [run](a.csv) |",
        "| c | unbounded | no | [run](a.csv) |",
    ]


def test_terminal_shows_what_markdown_shows() -> None:
    console = Console(width=200, file=io.StringIO())
    with console.capture() as shown:
        console.print(TABLE.terminal())
    assert all(word in shown.get() for row in TABLE.texts for word in row)


def test_csv_keeps_every_bit_and_quotes_commas() -> None:
    values = np.array([0.1, 1.0 / 3.0, math.nan])
    rows = list(
        csv.DictReader(
            io.StringIO(csv_text({"t": values, "x": np.outer(values, [1, 2]), "w": np.array(["a,b", "c", "d"])}))
        )
    )
    assert [float(row["t"]) for row in rows[:2]] == values[:2].tolist()
    assert rows[2]["t"] == "nan"
    assert float(rows[1]["x1"]) == 2 * values[1]
    assert rows[0]["w"] == "a,b"
    assert csv_text({"t": values}, digits=3) == "t\n0.1\n0.333\nnan\n"


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
    shown = dict(zip([column.heading for column in fastest.columns], fastest.texts[0], strict=True))
    assert shown["limit of main forces [N]"] == "none"
    assert shown["fastest with a plan [m/s]"] == "1.250"
    assert shown["slowest without [m/s]"] == "–"
