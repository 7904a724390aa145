"""One look for all figures: colours and line styles that also tell apart in black and white, and how to save."""

from __future__ import annotations

import functools
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from redundancy_pin.errors import OutputError, RedundancyPinError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FINER = 1.6
"""Pixels of the picture per pixel of the page: lettering stays sharp on dense screens."""


@functools.cache
def _page_class() -> type[Figure]:
    """Return the class of this package's figures; made when the first one is drawn, for it needs matplotlib."""
    from matplotlib.figure import Figure

    class Page(Figure):
        """A figure that a notebook shows without pyplot or ``%matplotlib inline``.

        IPython only knows how to show figures that pyplot made; those of this package keep out of its global state.
        """

        def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
            """Return the picture and the width, pixels, at which it is shown."""
            buffer = io.BytesIO()
            self.savefig(buffer, format="png", dpi=_FINER * self.dpi)
            return buffer.getvalue(), {"width": round(self.dpi * self.get_size_inches()[0])}

    return Page


@dataclass(frozen=True)
class Stroke:
    """How one series is drawn.

    Attributes:
        color: a colour of the Okabe–Ito palette, told apart with any colour vision.
        dash: matplotlib's line style, told apart without colour.
        marker: marker for sparse points of the same series.
    """

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

WINDOW_COLOR = "#D9D9D9"
_INSTANT: dict[str, Any] = {"color": "#000000", "linewidth": 0.9, "linestyle": (0, (1, 1.5))}

BEYOND = "beyond a limit"
"""What legends call the hatched part of an axis."""

_FORBIDDEN: dict[str, Any] = {"facecolor": "none", "edgecolor": "#8C8C8C", "hatch": "/////", "linewidth": 0.0}

_MINOR = (2.0, 0.6)
"""Decades on a logarithmic axis below which some, and below which all numbers between powers of ten are written."""

_FORMATS = ("png", "svg", "pdf")

_SETTINGS: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": True,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "#CCCCCC",
    "legend.fontsize": 8.0,
    "figure.dpi": 100,
    "savefig.dpi": 160,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "svg.fonttype": "path",
    "svg.hashsalt": "redundancy_pin",  # identifiers inside an SVG are random without it
}


@contextmanager
def figure(width: float, height: float) -> Iterator[Figure]:
    """Give an empty figure drawn in the common style; no window and no global state.

    Args:
        width: in inches.
        height: in inches.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    require_matplotlib()
    with _styled():
        yield _page_class()(figsize=(width, height), layout="constrained")


@contextmanager
def _styled() -> Iterator[None]:
    """Apply the common style, whatever the user's own defaults are."""
    import matplotlib.style

    with matplotlib.style.context(["default", _SETTINGS]):
        yield


def words(name: str) -> str:
    """Return a name in plain data, such as the value of a plan's status, as titles say it: "within limits"."""
    return name.replace("_", " ")


def require_matplotlib() -> None:
    """Check that plots can be made.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise RedundancyPinError(
            "Plots need matplotlib, which is not installed.",
            remedy="Install it with `pip install 'redundancy_pin[plot]'`.",
        ) from error


def save(drawn: Figure, *paths: str | Path) -> None:
    """Write a figure to files; the suffix decides on the format. The same figure gives the same bytes.

    Raises:
        OutputError: a suffix that is no picture format, or a file that cannot be written.
    """
    for path in (Path(path) for path in paths):
        kind = picture_format(path)
        stamp = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
        try:
            with _styled():
                drawn.savefig(path, format=kind, metadata=stamp)
        except OSError as error:
            raise OutputError(
                f"Cannot write {path}: {error.strerror or error}.", remedy="Choose another place.", path=str(path)
            ) from error


def picture_format(path: str | Path) -> str:
    """Return the format that the suffix of a file stands for.

    Raises:
        OutputError: it stands for none that is written here.
    """
    kind = Path(path).suffix[1:].lower()
    if kind not in _FORMATS:
        raise OutputError(
            f"Cannot write {path}: {Path(path).suffix or 'no suffix'} is no picture format.",
            remedy=f"Use .{', .'.join(_FORMATS)}.",
            path=str(path),
        )
    return kind


def mark_singular(
    axes: Axes, windows: Sequence[tuple[float, float]], instants: Sequence[float], *, label: bool = False
) -> None:
    """Shade near-singular time windows and draw a line at each singular instant.

    Args:
        axes: with time, s, on the abscissa.
        windows: first and last time of each window, s.
        instants: singular instants, s.
        label: whether the two appear in the legend.
    """
    for index, (start, end) in enumerate(windows):
        name = "near-singular" if label and index == 0 else None
        axes.axvspan(start, end, color=WINDOW_COLOR, linewidth=0, zorder=0.5, label=name)
    for index, instant in enumerate(instants):
        name = "singular instant" if label and index == 0 else None
        axes.axvline(instant, zorder=1.5, label=name, **_INSTANT)


def mark_instants(axes: Axes, instants: Sequence[float]) -> None:
    """Draw a dotted line at each singular instant, s."""
    for instant in instants:
        axes.axvline(instant, zorder=1.6, **_INSTANT)


def instant_handle() -> Artist:
    """Return what a legend shows of ``mark_instants``."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label="singular instant", **_INSTANT)


def hatch_beyond(axes: Axes, edge: float, far: float, *, label: str | None = None) -> None:
    """Hatch what lies between a limit and the end of the axis behind it, on the ordinate."""
    axes.axhspan(min(edge, far), max(edge, far), zorder=0.4, label=label, **_FORBIDDEN)


def beyond_handle() -> Artist:
    """Return what a legend shows of ``hatch_beyond``."""
    from matplotlib.patches import Patch

    return Patch(label=BEYOND, **_FORBIDDEN)


def plain_log(axes: Axes) -> None:
    """Make the ordinate logarithmic with numbers a reader need not translate: 20 in place of 2×10¹."""
    from matplotlib.ticker import LogFormatter

    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(LogFormatter(minor_thresholds=_MINOR))
    axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=_MINOR))


def legend_above(axes: Axes, columns: int) -> None:
    """Put the legend above the axes, where it hides nothing."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0, 1.0, 0.1),
        ncols=columns,
        frameon=False,
        borderaxespad=0.1,
        handlelength=2.6,
        columnspacing=1.2,
    )
