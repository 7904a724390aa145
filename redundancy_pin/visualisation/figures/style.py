"""One style for all figures: colours, line styles, legends, and how a figure is saved."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from redundancy_pin.errors import shortened
from redundancy_pin.io.files import refusing, replacing_file, require_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend


@dataclass(frozen=True)
class Stroke:
    """How one series is drawn: a colour of the Okabe–Ito palette; line style and marker distinguish it in grey."""

    color: str
    dash: Any
    marker: str


STROKES = (
    Stroke("#0072B2", "-", "o"),
    Stroke("#D55E00", (0, (5, 1.5)), "s"),
    Stroke("#009E73", (0, (4, 1.2, 1, 1.2)), "^"),
    Stroke("#CC79A7", (0, (1, 1)), "D"),
    Stroke("#E69F00", (0, (7, 1.5, 1, 1.5, 1, 1.5)), "v"),
    Stroke("#56B4E9", (0, (2, 2)), "P"),
)
"""Strokes of the first, second, ... series of a plot; main actuators have the first ones."""

CARRIER_STROKES = (
    Stroke("#5E2CA5", "-", "o"),
    Stroke("#D6219C", (0, (5, 1.5)), "s"),
    Stroke("#9C7BD9", (0, (4, 1.2, 1, 1.2)), "^"),
    Stroke("#8C1D5B", (0, (1, 1)), "D"),
)
"""Strokes of the carriers: violets and reds that no main actuator has, of different lightness.

The line style is that of the main actuator with the same number.
"""

BEYOND: dict[str, Any] = {
    "facecolor": "none", "edgecolor": "#8C8C8C", "hatch": "/////", "linewidth": 0.0, "label": "beyond a limit"
}  # fmt: skip
"""How what a limit forbids is drawn, and what legends call it."""

INSTANT: dict[str, Any] = {
    "color": "#000000", "linewidth": 0.9, "linestyle": (0, (1, 1.5)), "label": "singular instant"
}  # fmt: skip
"""How a singular instant is drawn, and what legends call it."""

# How an interval of near-singular samples is drawn, and what legends call it
WINDOW: dict[str, Any] = {"facecolor": "#D9D9D9", "edgecolor": "none", "label": "near-singular"}
# How an interval without efforts within their bounds is drawn, and what legends call them
WITHOUT_EFFORTS: dict[str, Any] = {
    "facecolor": "none", "edgecolor": "#DDA98C", "hatch": "\\\\\\", "linewidth": 0.6, "label": "no efforts"
}  # fmt: skip
_FORMATS = (".png", ".svg", ".pdf")

_LETTERS, _KEY = 15.0, 9  # letters of a legend on an inch, and how many of them an entry takes with its line and space
_TITLE_LETTERS = 12.0  # letters of a title on an inch
_LONGEST_LABEL = 44  # letters of a label; longer ones lose their middle
_ZERO_WIDTH = "\N{ZERO WIDTH SPACE}"  # before a name that begins with an underscore: matplotlib hides such labels
SETTINGS: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.titlesize": 10.5,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.columnspacing": 1.2,
    "legend.handlelength": 2.6,
    "figure.dpi": 100,
    "savefig.dpi": 160,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "svg.fonttype": "path",
    "svg.hashsalt": "redundancy_pin",  # identifiers inside an SVG are random without it
    "text.parse_math": False,  # a $ in the name of a joint or a robot is a letter
}


@contextmanager
def figure(width: float, height: float, title: str = "") -> Iterator[Figure]:
    """Give an empty figure, inches, in the common style; no window and no global state.

    When the block ends, long titles are broken, and long labels of axes lose their middle.
    """
    from redundancy_pin.visualisation.figures.page import Page

    with _styled():
        page = Page(figsize=(width, height), layout="constrained")
        if title:
            page.suptitle(break_lines(title, width))
        yield page
        for axes in page.axes:
            place = axes.get_subplotspec()
            axes.title.set_text(break_lines(axes.get_title(), width / place.get_gridspec().ncols if place else width))
            for label in (axes.xaxis.label, axes.yaxis.label):
                label.set_text(brief(label.get_text()))


def break_lines(text: str, width: float) -> str:
    """Return a title with its lines broken where they are longer than ``width``, inches."""
    most = max(int(_TITLE_LETTERS * width), 1)
    return "\n".join(textwrap.fill(line, most) if len(line) > most else line for line in text.split("\n"))


def legend_label(name: str) -> str:
    """Return a name as a label that a legend shows: not too long, and though it begins with an underscore."""
    return (_ZERO_WIDTH if name.startswith("_") else "") + brief(name)


def brief(text: str) -> str:
    """Return a text of a picture; a long one loses its middle."""
    return shortened(text, _LONGEST_LABEL)


@contextmanager
def _styled() -> Iterator[None]:
    """Apply the common style, whatever the user's own defaults are."""
    import matplotlib.style

    with matplotlib.style.context(["default", SETTINGS]), warnings.catch_warnings():
        # a letter that the font lacks is drawn as a box
        warnings.filterwarnings("ignore", r"Glyph \d+ .*missing from")
        yield


def save(drawn: Figure, *paths: str | Path) -> None:
    """Write a figure to files, each whole or not at all; the suffix decides on the format.

    Raises:
        OutputError: a suffix of another format, or a file that cannot be written.
    """
    kinds = [picture_format(path) for path in paths]
    for path, kind in zip(paths, kinds, strict=True):
        stamp = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
        with _styled(), replacing_file(path) as temporary, refusing(path):
            drawn.savefig(temporary, format=kind, metadata=stamp)


def picture_format(path: str | Path) -> str:
    """Return the picture format of a file by its suffix."""
    return require_suffix(path, _FORMATS)[1:]


def log_scale(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with numbers a reader need not translate: 20 in place of 2×10¹."""
    from matplotlib.ticker import LogFormatter

    axes.set_yscale("log")
    # decades on the axis below which some, and below which all numbers between powers of ten are written
    for set_formatter in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        set_formatter(LogFormatter(minor_thresholds=(2.0, 0.6)))


def legend_above(axes: Axes, width: float) -> None:
    """Put the legend above axes that are ``width`` inches wide, so that it hides nothing; no legend without labels."""
    labels = axes.get_legend_handles_labels()[1]
    if labels:
        columns = _columns(labels, width)
        legend = axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0, 1.0, 0.1), ncols=columns, borderaxespad=0.1)
        _show_names(legend)


def legend_below(drawn: Figure) -> None:
    """Put a legend under all axes: each thing once that no legend of the axes names."""
    legends = [axes.get_legend() for axes in drawn.axes]
    named = {text.get_text() for legend in legends if legend for text in legend.get_texts()}
    found = {
        str(label): handle
        for axes in drawn.axes
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        if str(label).removeprefix(_ZERO_WIDTH) not in named
    }
    found = dict(sorted(found.items(), key=lambda item: -item[1].get_zorder()))  # what is behind all comes last
    if found:
        columns = _columns([*found], drawn.get_figwidth())
        _show_names(drawn.legend([*found.values()], [*found], loc="outside lower center", ncols=columns))


def _show_names(legend: Legend) -> None:
    for text in legend.get_texts():
        text.set_text(text.get_text().removeprefix(_ZERO_WIDTH))


def _columns(labels: Sequence[str], width: float) -> int:
    """Return in how many columns of equal width entries fit."""
    return max(1, min(len(labels), int(_LETTERS * width) // (_KEY + max(map(len, labels)))))
