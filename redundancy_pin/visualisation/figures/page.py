"""Figures that show themselves in a notebook. Imports matplotlib: import this module where a figure is drawn."""

from __future__ import annotations

import io

from matplotlib.figure import Figure

_FINER = 1.6  # pixels of the picture per pixel of the page: lettering stays sharp on dense screens


class Page(Figure):
    """A figure that a notebook shows without pyplot or ``%matplotlib inline``.

    IPython shows only figures that pyplot made; figures of this package do not use pyplot's global state.
    """

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return the picture and the width, pixels, at which it is shown."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=_FINER * self.dpi)
        return buffer.getvalue(), {"width": round(self.dpi * self.get_size_inches()[0])}
