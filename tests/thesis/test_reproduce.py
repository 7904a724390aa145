"""The main job: what it writes, that it writes all or nothing, and that disagreement stops it."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import quick_results
from matplotlib.figure import Figure
from quick_results import motion, reproduction, require_self_contained

from redundancy_pin import crosscheck
from redundancy_pin.crosscheck import CheckRow, CrossCheckReport
from redundancy_pin.dynamics.virtual_work import VirtualWorkAlongMotion
from redundancy_pin.errors import CrossCheckError, OutputError
from redundancy_pin.thesis import beyond
from redundancy_pin.thesis import reproduce as job
from redundancy_pin.thesis.cases import CHAPTERS, FULL, QUICK, TURNS, Case
from redundancy_pin.thesis.figures import THESIS, Picture, pictures
from redundancy_pin.thesis.page import html
from redundancy_pin.thesis.reproduce import Reproduction
from redundancy_pin.thesis.table import Record, Table, data, table
from redundancy_pin.visualisation.figures.style import save

WRITTEN = Figure.savefig
ALONE = replace(FULL, chapters=(), samples=1, jobs=1)


def reproduce(folder: Path, motions: Sequence[Case], progress: Any = None, **changed: Any) -> Reproduction:
    """Run the job without chapters, which are run once in ``quick_results``; the cross-check has tests of its own."""
    return job.reproduce(folder, replace(ALONE, motions=tuple(motions), **changed), progress=progress)


SLOW_CHAPTERS = [pytest.param(name, marks=pytest.mark.long) for name in CHAPTERS]
"""Ten to forty seconds each, however coarse."""

NAMES = ("circle-0.5-parked", "corner-r0.025-baseline", "corner-r0.025-parked")
BASELINE, SHARP = "corner-r0.025-baseline", "corner-r0.013-baseline"


@pytest.fixture(scope="module", autouse=True)
def _few_coarse_pictures() -> Iterator[None]:
    """The path of the circle in few pixels; the others, saved by the same function, are empty."""

    def some(drawn: Figure, *paths: Path) -> None:
        if paths[0].stem == f"{NAMES[0]}-path":
            save(drawn, *paths)
        else:
            _ = [path.write_bytes(b"\x89PNG") for path in paths]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Figure, "savefig", lambda *given, **options: WRITTEN(*given, **options, dpi=40))
        patched.setattr(job, "save", some)
        yield


@pytest.fixture(scope="module")
def told() -> list[tuple[int, int]]:
    """What ``done`` says of its progress."""
    return []


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, told: list[tuple[int, int]]) -> Reproduction:
    def tell(done: int, total: int, what: str) -> None:
        told.append((done, total))

    return reproduce(tmp_path_factory.mktemp("job") / "results", [motion(name) for name in NAMES], progress=tell)


def test_every_promised_file_is_there_and_nothing_beside_them(done: Reproduction) -> None:
    expected = {"summary.json", "report.md", "report.html", *(f"{name}.csv" for name in NAMES)}
    stems = [f"{name}-{kind}" for name in NAMES for kind in ("efforts", "path")] + ["corner-r0.025-comparison"]
    expected |= {f"{stem}{suffix}" for stem in stems for suffix in (".png", ".svg")}
    assert {path.name for path in done.folder.iterdir()} == expected
    assert [path.name for path in done.folder.parent.iterdir()] == ["results"]


def test_summary_is_strict_json_with_versions(done: Reproduction) -> None:
    def refuse(text: str) -> None:
        raise AssertionError(text)

    data = json.loads((done.folder / "summary.json").read_text(), parse_constant=refuse)
    assert list(data) == ["format", "format_version", "extent", "versions", "cross_check", "experiments", "thesis",
                          "planned", "beyond", "future", "replay", "notes", "files"]  # fmt: skip
    assert data["format_version"] == 2
    assert {"redundancy_pin", "python", "pin", "numpy"} <= set(data["versions"])
    assert data["cross_check"]["passed"]
    assert list(data["experiments"]) == list(NAMES)
    circle = data["experiments"]["circle-0.5-parked"]
    assert not circle["bounded"]
    assert len(circle["singular_instants"]) == 2
    assert data["experiments"][BASELINE]["bounded"]
    assert sorted([*data["files"], "summary.json"]) == sorted(path.name for path in done.folder.iterdir())
    assert done.summary == data


def test_csv_holds_both_backends_and_the_singular_instants(done: Reproduction) -> None:
    with (done.folder / "circle-0.5-parked.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == [
        "t [s]", "x [m]", "y [m]", "xd [m/s]", "yd [m/s]", "xdd [m/s^2]", "ydd [m/s^2]", "tau:slide_1 [N]",
        "tau:slide_2 [N]", "tau_virtual_work:slide_1 [N]", "tau_virtual_work:slide_2 [N]", "tau:carrier_1 [N]",
        "tau:carrier_2 [N]", "status", "margin", "condition", "residual [N]",
    ]  # fmt: skip
    first, second = (
        np.array([float(row[name]) for row in rows]) for name in ("tau:slide_1 [N]", "tau_virtual_work:slide_1 [N]")
    )
    regular = np.array([row["status"] == "ok" for row in rows])
    np.testing.assert_allclose(first[regular], second[regular], rtol=1e-9, atol=1e-11)  # twelve digits are written
    singular = [row for row in rows if row["status"] == "singular_inconsistent"]
    assert len(singular) == 2
    assert all(row["tau:slide_1 [N]"] == "nan" and float(row["residual [N]"]) > 0.1 for row in singular)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are empty, and nothing is cross-checked."""
    quick_results.spare(monkeypatch)


@pytest.mark.parametrize("names", [NAMES[:1], pytest.param(NAMES, marks=pytest.mark.long)])
def test_the_same_run_gives_the_same_bytes(
    names: tuple[str, ...], done: Reproduction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one motion the files of its own; of all of them summary and report too, and by several processes."""
    if names == NAMES:  # other processes draw all pictures, and in all their pixels
        monkeypatch.setattr(job, "save", save)
        monkeypatch.setattr(Figure, "savefig", WRITTEN)
        done = reproduce(tmp_path / "first", [motion(name) for name in names])
    again = reproduce(tmp_path / "again", [motion(name) for name in names], jobs=len(names))
    same = [path for path in done.folder.iterdir() if names == NAMES or path.name.startswith(names[0])]
    assert len(same) >= 5
    for path in same:
        assert path.read_bytes() == (again.folder / path.name).read_bytes(), path.name


@pytest.mark.parametrize("chapter", [*SLOW_CHAPTERS, ""])
def test_reports_show_every_figure_and_link_to_files_that_exist(chapter: str, done: Reproduction) -> None:
    made = reproduction(chapter) if chapter else done
    text = (made.folder / "report.md").read_text()
    links = [part.split(")")[0] for part in text.split("](")[1:]]
    for link in links:
        assert (made.folder / link).is_file(), link
    drawn = [picture for group in pictures(made.results).values() for picture in group]
    assert {f"{picture.stem}.png" for picture in drawn} <= set(links)
    for picture in drawn:
        assert (made.folder / f"{picture.stem}.png").read_bytes().startswith(b"\x89PNG")
    listed = json.loads((made.folder / "summary.json").read_text())["files"]
    assert sorted([*listed, "summary.json"]) == sorted(path.name for path in made.folder.iterdir())
    assert len(require_self_contained((made.folder / "report.html").read_text())) == len(drawn)


def holds(key: str, record: Record) -> bool:
    first, _, rest = key.partition(".")
    inner = record.get(first)
    return key in record or (isinstance(inner, Mapping) and bool(rest) and holds(rest, dict(inner)))


@pytest.mark.parametrize("chapter", [*SLOW_CHAPTERS, ""])
def test_each_column_of_a_table_is_in_a_record(
    chapter: str, done: Reproduction, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: dict[str, list[Record]] = {}

    def noted(name: str, records: Sequence[Record], *more: Any) -> Table:
        made[name] = [*records]
        return table(name, records, *more)

    results = (reproduction(chapter) if chapter else done).results
    if chapter == "beyond":  # a quick run has no efforts that were aimed at, no trade-off, and no speed without a plan
        own = results.chapters["beyond"]
        race = {**own["fastest"][0], "slowest_without": own["fastest"][0]["fastest_with_plan"]}
        more = {"targets": beyond.targets(own["plans"]), "fastest": [race],
                "trade_off": [beyond.trade_record(TURNS[0], replace(QUICK, ratios=(1.0,)))]}  # fmt: skip
        results = replace(results, chapters={"beyond": {**own, **more}})
    if chapter == "planned":
        planned = results.chapters["planned"]
        missing = [{**record, "plans": 5, "without": 3} for record in planned["sensitivity"]]
        results = replace(results, chapters={"planned": {**planned, "sensitivity": missing}})
    for module in (job, beyond):
        monkeypatch.setattr(module, "table", noted)
    shown = job.tables(results)
    if chapter == "planned":
        assert all("(3 of 5 without a plan)" in line for line in shown["sensitivity"].markdown().splitlines()[2:])
    unknown = [(name, key) for name, records in made.items() for key in data("tables")[name]
               if not any(holds(key, record) for record in records)]  # fmt: skip
    assert made
    assert not unknown


def test_the_report_shows_every_table() -> None:
    page = (Path(job.__file__).parent / "report.md.j2").read_text()
    assert set(re.findall(r'table\("(\w+)"\)', page)) == set(data("tables"))


def one_of_each(drawn: list[Picture]) -> list[Picture]:
    """Pictures by functions of their own; the others differ in their case."""
    return list({picture.draw.func: picture for picture in drawn}.values())  # type: ignore[attr-defined]


@pytest.mark.parametrize("choose", [one_of_each, pytest.param(list, marks=pytest.mark.long)], ids=["some", "all"])
@pytest.mark.parametrize("chapter", SLOW_CHAPTERS)
def test_figures_can_be_drawn(chapter: str, choose: Callable[[list[Picture]], list[Picture]], tmp_path: Path) -> None:
    results = reproduction(chapter).results
    drawn = choose(pictures(results)[chapter])
    assert drawn
    for picture in drawn:
        figure = picture.draw()
        assert all(axes.has_data() or axes.texts for axes in figure.axes), picture.stem
        save(figure, tmp_path / f"{picture.stem}.png")
        assert (tmp_path / f"{picture.stem}.png").read_bytes().startswith(b"\x89PNG")


def test_every_result_figure_of_the_thesis_is_drawn() -> None:
    assert [number for number, _, _ in THESIS] == [*(f"3.{i}" for i in range(6, 23)), *(f"4.{i}" for i in range(2, 19))]


@pytest.mark.long
def test_verdicts_of_the_run_are_in_the_report() -> None:
    text = (reproduction("planned").folder / "report.md").read_text()
    for record in quick_results.chapter("planned")["conclusions"]:
        assert f"| {record['claim']} | {record['stands']} | {record['here']} |".replace("|τ|", "\\|τ\\|") in text
    judged = quick_results.chapter("planned")["against_thesis"]
    assert f"{len(judged)}; {sum(record['as_run'] for record in judged)} are reproduced by the run itself" in text


def test_html_escapes_text_colours_verdicts_and_embeds_pictures(tmp_path: Path) -> None:
    (tmp_path / "picture.png").write_bytes(b"\x89PNG")
    markdown = (
        "# A & b\n\n## Part <two>\n\n`code` <script>\n\n| [run](run.csv) | v |\n| --- | --- |\n| <b> | differs: x |\n"
    )
    page = html(markdown + '\n![a "caption"](picture.png)\n', tmp_path)
    assert len(require_self_contained(page)) == 1
    seen = quick_results.Page(page)
    assert not [tag for tag, _ in seen.tags if tag in ("two", "b")]
    assert "<script>" in seen.text
    assert [attributes.get("class") for tag, attributes in seen.tags if tag == "td"] == [None, "bad"]
    with pytest.raises(OutputError, match=r"picture\.png"):
        html(markdown + "\n![a](picture.png)\n", tmp_path / "elsewhere")


@pytest.mark.usefixtures("undrawn")
def test_earlier_results_are_replaced_as_a_whole_and_survive_a_failure_midway(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "results"
    reproduce(folder, [motion(BASELINE)])
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def fails(*_: object) -> str:
        raise OutputError("The disk is full.")

    with monkeypatch.context() as patched:
        patched.setattr(job, "report", fails)  # after data and figures are written
        for target in (folder, tmp_path / "other"):
            with pytest.raises(OutputError):
                reproduce(target, [motion(SHARP)])
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
    reproduce(folder, [motion(SHARP)])
    assert not list(folder.glob("corner-r0.025*"))
    assert list(folder.glob("corner-r0.013*"))
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_disagreeing_backends_stop_the_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sign flipped in one backend must be seen by the cross-check, before anything is run or written."""
    original = VirtualWorkAlongMotion.reduce

    def flipped(self: VirtualWorkAlongMotion, carriers: object = None) -> object:
        right = original(self, carriers)  # type: ignore[arg-type]
        return type(right)(**{**vars(right), "f": -right.f})

    monkeypatch.setattr(VirtualWorkAlongMotion, "reduce", flipped)
    monkeypatch.setattr(job, "compute", lambda *_: pytest.fail("an experiment was run"))
    with pytest.raises(CrossCheckError, match="cross-check fails"):
        reproduce(tmp_path / "results", [motion(BASELINE)], samples=100)
    assert list(tmp_path.iterdir()) == []


def test_robots_that_nothing_judges_stop_the_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    agree = CrossCheckReport((CheckRow("2rpr", "parity: f", 10, 1e-15, 1e-10, True),), 0)
    monkeypatch.setattr(crosscheck, "run", lambda *_: agree)
    with pytest.raises(CrossCheckError, match="nothing to judge 2rpr by"):
        reproduce(tmp_path / "results", [motion(BASELINE)])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("what", ["file", "foreign", "parent"])
def test_a_folder_that_cannot_be_written_is_refused_first(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crosscheck, "run", lambda *_: pytest.fail("work was done"))
    folder = tmp_path / "results"
    if what == "file":
        folder.write_text("mine")
    elif what == "foreign":
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
    else:
        folder = tmp_path / "no" / "results"
    with pytest.raises(OutputError):
        reproduce(folder, [motion(BASELINE)])
    if what == "foreign":
        assert (folder / "notes.txt").read_text() == "mine"


@pytest.mark.usefixtures("done")
def test_progress_counts_up_to_the_total(told: list[tuple[int, int]]) -> None:
    assert told == sorted(told)
    assert len(told) > 3 * len(NAMES)
    assert told[-1][0] == told[-1][1]
    assert len({total for _, total in told}) == 1


@pytest.mark.long
def test_each_plan_is_replayed_or_the_reason_is_there() -> None:
    made = reproduction("replay")
    records = {(record["plan"], record["drive"]): record for record in quick_results.chapter("replay")["replays"]}
    massless = records["circle-0.5, switching off", "open loop"]
    assert massless["status"] == "not_converged"
    assert "no inertia" in massless["reason"]
    corner = records["corner-r0.025, whole trajectory: effort", "open loop"]
    assert corner["status"] == "ok"
    assert corner["largest"] < 1e-6
    (missing,) = quick_results.chapter("replay")["without_plan"].values()
    assert "nothing can carry the inertial force" in missing
    text = (made.folder / "report.md").read_text()
    assert massless["reason"] in text
    assert missing in text
    lines = (made.folder / "replay.csv").read_text().splitlines()
    assert len(lines) == 1 + len(records)
    assert {line.count(",") for line in lines} == {11}
    assert made.summary["replay"]["replays"][0]["largest"] is None
