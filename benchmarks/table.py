"""The table of docs/tables/speed.md from what pytest-benchmark has written: ``make bench``.

python benchmarks/table.py build/benchmarks.json
"""

import json
import sys
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "tables" / "speed.md"
BEGIN, END = "<!-- benchmarks: `make bench` writes them -->\n", "<!-- end of benchmarks -->"
HEAD = "| work | by | time | of the first |\n| --- | --- | ---: | ---: |\n"


def shown(seconds):
    """Return a time with its unit, to three digits."""
    size, unit = (1.0, "s") if seconds >= 1.0 else (1e-3, "ms") if seconds >= 1e-3 else (1e-6, "µs")
    return f"{seconds / size:.3g} {unit}"


def table(report):
    """Return the rows: least times (other programs only add), and their shares of the first of the same work."""
    first, rows = {}, []
    for one in report["benchmarks"]:
        group, seconds = one["group"], one["stats"]["min"] / one["extra_info"].get("units", 1.0)
        work = "" if group in first else group
        reference = first.setdefault(group, seconds)
        ratio = "" if work or group == "a plan" else f"{seconds / reference:.2g}"
        rows.append(f"| {work} | {one['params']['who']} | {shown(seconds)} | {ratio} |")
    return HEAD + "\n".join(rows)


def machine(report):
    """Return a sentence about the machine."""
    cpu, python = report["machine_info"]["cpu"], report["machine_info"]["python_version"]
    return f"Least times on {cpu['count']} cores of {cpu.get('brand_raw', cpu['arch'])}, one thread, Python {python}."


def main():
    report = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    text = f"{before}{BEGIN}\n{machine(report)}\n\n{table(report)}\n\n{END}{rest.split(END)[1]}"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
