"""Figures that show themselves in a notebook, go to other processes, and look the same in every run.

The one module of this package that imports matplotlib as it is imported: what needs it imports this one where it draws.
"""

from __future__ import annotations

import io
from typing import Any

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.transforms import Bbox

_DIGITS = 9  # of a fraction of the page
_FINER = 1.6  # pixels of the picture per pixel of the page: lettering stays sharp on dense screens


class Page(Figure):
    """A figure that a notebook shows without pyplot or ``%matplotlib inline``.

    IPython only knows how to show figures that pyplot made; those of this package keep out of its global state.
    """

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return the picture and the width, pixels, at which it is shown."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=_FINER * self.dpi)
        return buffer.getvalue(), {"width": round(self.dpi * self.get_size_inches()[0])}


class RepeatableLayout(ConstrainedLayoutEngine):
    """Matplotlib's constrained layout, made repeatable.

    Its solver visits objects in the order of their addresses, and its last digits, which names in an SVG are made of,
    differ from run to run.
    """

    def execute(self, fig: Any) -> Any:
        """Lay a figure out, its axes at places of a few digits."""
        result = super().execute(fig)
        for axes in fig.axes:  # as the engine itself does; set_position would take them out of the layout
            axes._set_position(Bbox(axes.get_position(original=True).get_points().round(_DIGITS)))
        return result
