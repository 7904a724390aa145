"""What is promised, how often it was tried, and how often it failed: counted by tests, printed at the end of a run.

``build/promises.json`` keeps the counts. ``python tests/support/promises.py`` writes them into the table of
``docs/trust.md``, whose rows name them in comments: ``count: files`` and ``failed: files``.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
COUNTS = ROOT / "build" / "promises.json"
PAGE = ROOT / "docs" / "trust.md"

KEY = "promise"
"""Of a report's ``user_properties``, which reach the process that prints from those that test."""

Keep = Callable[[str, str, Mapping[str, int], Mapping[str, int]], None]
"""From a promise as ``docs/trust.md`` names it, the kind of cases, counts of how they ended ("right", "refused",
"wrong"), and of the classes of what was wrong."""


@pytest.fixture
def keep(request: pytest.FixtureRequest) -> Keep:
    """Note down how cases of a promise ended."""

    def note(promise: str, kind: str, counts: Mapping[str, int], classes: Mapping[str, int]) -> None:
        entry = {"promise": f"{promise}: {kind}", "counts": dict(counts), "classes": dict(classes)}
        request.node.user_properties.append((KEY, entry))

    return note


def collected(reports: Iterable[Any]) -> dict[str, dict[str, Counter[str]]]:
    """Return the counts of each promise, summed over reports."""
    found: dict[str, dict[str, Counter[str]]] = {}
    for report in reports:
        for key, entry in getattr(report, "user_properties", ()):
            if key == KEY and report.when == "call":
                sums = found.setdefault(entry["promise"], {"counts": Counter(), "classes": Counter()})
                for part in sums:
                    sums[part].update(entry[part])
    return dict(sorted(found.items()))


def lines(found: Mapping[str, Mapping[str, Counter[str]]]) -> list[str]:
    """Return the table, in markdown."""
    rows = ["| promise | tried | right | refused | failed |", "|---|---|---|---|---|"]
    for promise, sums in found.items():
        counts = sums["counts"]
        rows.append(
            f"| {promise} | {counts.total():,} | {counts['right']:,} | {counts['refused']:,} | {counts['wrong']:,} |"
        )
    return rows


def summarise(terminal: Any) -> None:
    """Print the table and the classes of failures, and write both to files."""
    found = collected(report for reports in terminal.stats.values() for report in reports)
    if not found:
        return
    terminal.section("promises")
    for line in lines(found):
        terminal.write_line(line)
    for promise, sums in found.items():
        for reason, times in sums["classes"].most_common():
            terminal.write_line(f"failed {times} times: {promise}: {reason}")
    COUNTS.parent.mkdir(exist_ok=True)
    COUNTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Write the counts of the last run into the page; what it did not try stays as it is."""
    page = PAGE.read_text(encoding="utf-8")
    tried: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    for promise, sums in json.loads(COUNTS.read_text(encoding="utf-8")).items():
        name = promise.partition(":")[0]
        tried[name] += sum(sums["counts"].values())
        failed[name] += sums["counts"].get("wrong", 0)
    for name in tried:
        for word, count in (("count", tried[name]), ("failed", failed[name])):
            page = re.sub(rf"\| [^|]*<!-- {word}: {name} -->", f"| {count:,} <!-- {word}: {name} -->", page)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
