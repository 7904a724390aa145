"""Published problems: digits and processor times, into docs/tables/published_problems.md (``make bench`` does it too).

python tests/oracles/published_table.py
"""

from pathlib import Path

import published

PAGE = Path(__file__).parents[2] / "docs" / "tables" / "published_problems.md"
BEGIN, END = "<!-- table: `make bench` writes it -->\n", "<!-- end of table -->"


def rows():
    records = published.rows()
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}{published.table(records)}\n{END}{rest.split(END)[1]}", encoding="utf-8")
    return records


if __name__ == "__main__":
    rows()
