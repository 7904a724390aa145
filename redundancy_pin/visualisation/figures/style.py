"""One style for all figures: ``style.mplstyle``, strokes and fills, legends, and how a figure is saved."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from redundancy_pin.errors import shortened
from redundancy_pin.io.files import refusing, replacing_file, require_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

Stroke = dict[str, Any]
"""Keywords of matplotlib's ``plot`` for one series; line style and marker distinguish it in grey."""

_DASHES = ("-", (0, (5, 1.5)), (0, (4, 1.2, 1, 1.2)), (0, (1, 1)), (0, (7, 1.5, 1, 1.5, 1, 1.5)), (0, (2, 2)))
_MARKERS = "os^DvP"


def _strokes(*colors: str) -> tuple[Stroke, ...]:
    return tuple(
        {"color": color, "linestyle": dash, "marker": marker}
        for color, dash, marker in zip(colors, _DASHES, _MARKERS, strict=False)
    )


STROKES = _strokes("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Strokes of the first, second, ... series of a plot, in the Okabe–Ito palette; main actuators have the first ones."""

CARRIER_STROKES = _strokes("#5E2CA5", "#D6219C", "#9C7BD9", "#8C1D5B")
"""Strokes of the carriers: violets and reds of different lightness that no main actuator has."""

BEHIND: Stroke = {"color": "#6E6E6E", "linestyle": "-", "linewidth": 1.0, "zorder": 2.0, "marker": "o"}
"""Stroke of curves with which others are compared."""

BEYOND: dict[str, Any] = {
    "facecolor": "none", "edgecolor": "#8C8C8C", "hatch": "/////", "linewidth": 0.0, "label": "beyond a limit"
}  # fmt: skip
"""Fill of inadmissible values."""

INSTANT: dict[str, Any] = {
    "color": "#000000", "linewidth": 0.9, "linestyle": (0, (1, 1.5)), "label": "singular instant"
}  # fmt: skip
"""Line of a singular instant."""

WINDOW: dict[str, Any] = {"facecolor": "#D9D9D9", "edgecolor": "none", "label": "near-singular"}
"""Fill of an interval of near-singular samples."""

WITHOUT_EFFORTS: dict[str, Any] = {
    "facecolor": "none", "edgecolor": "#DDA98C", "hatch": "\\\\\\", "linewidth": 0.6, "label": "no efforts"
}  # fmt: skip
"""Fill of an interval in which no efforts are within their bounds."""

_FORMATS = (".png", ".svg", ".pdf")
_LETTERS, _KEY = 15.0, 9  # letters of a legend on an inch, and the letters that line and space of an entry take
_TITLE_LETTERS = 12.0  # letters of a title on an inch
_LONGEST_LABEL = 44  # letters of a label
_ZERO_WIDTH = "\N{ZERO WIDTH SPACE}"  # before a name that begins with an underscore: matplotlib hides such labels


@contextmanager
def figure(width: float, height: float, title: str = "") -> Iterator[Figure]:
    """Give an empty figure, inches, in the common style; no window and no global state."""
    from redundancy_pin.visualisation.figures.page import Page

    with _styled():
        page = Page(figsize=(width, height))
        page.suptitle(break_lines(title, width))
        yield page


def break_lines(text: str, width: float) -> str:
    """Return a title with its lines broken where they are longer than ``width``, inches."""
    # matplotlib's own wrapping takes a $ in a name for the start of a formula
    return "\n".join(textwrap.fill(line, int(_TITLE_LETTERS * width)) for line in text.split("\n"))


def brief(text: str) -> str:
    """Return a label without the middle of a long one, visible in legends if it begins with an underscore."""
    return (_ZERO_WIDTH if text.startswith("_") else "") + shortened(text, _LONGEST_LABEL)


@contextmanager
def _styled() -> Iterator[None]:
    """Apply the common style, whatever the user's own defaults are."""
    import matplotlib.style

    style: list[str | Path] = ["default", Path(__file__).with_name("style.mplstyle")]
    with matplotlib.style.context(style), warnings.catch_warnings():
        # a letter that the font lacks is drawn as a box
        warnings.filterwarnings("ignore", r"Glyph \d+ .*missing from")
        yield


def save(drawn: Figure, *paths: str | Path) -> None:
    """Write a figure to files, each whole or not at all; the suffix decides on the format.

    Example:
        >>> rp.plot.save(rp.plot.efforts(plan), "efforts.svg", "efforts.png")  # doctest: +SKIP

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


def legend_above(axes: Axes, width: float) -> None:
    """Put the legend above axes that are ``width`` inches wide; no legend without labels."""
    labels = axes.get_legend_handles_labels()[1]
    if labels:
        _show_names(axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0, 1.0, 0.1), ncols=_columns(labels, width)))


def legend_below(drawn: Figure) -> None:
    """Put a legend under all axes: each label once, without the labels in legends of the axes."""
    legends = [axes.get_legend() for axes in drawn.axes]
    named = {brief(text.get_text()) for legend in legends if legend for text in legend.get_texts()}
    handles = [handle for axes in drawn.axes for handle in axes.get_legend_handles_labels()[0]]
    found = {str(handle.get_label()): handle for handle in handles if handle.get_label() not in named}
    if found:
        last = sorted(found.values(), key=lambda handle: -handle.get_zorder())  # fills come last
        columns = _columns([*found], drawn.get_figwidth())
        _show_names(drawn.legend(handles=last, loc="outside lower center", ncols=columns))


def _show_names(legend: Legend) -> None:
    for text in legend.get_texts():
        text.set_text(text.get_text().removeprefix(_ZERO_WIDTH))


def _columns(labels: Sequence[str], width: float) -> int:
    """Return the number of columns of equal width in which entries fit."""
    return max(1, min(len(labels), int(_LETTERS * width) // (_KEY + max(map(len, labels)))))
