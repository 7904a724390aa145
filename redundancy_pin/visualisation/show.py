"""A moving picture to look at: as one HTML file, in a notebook cell, or served to a browser."""

from __future__ import annotations

import html
import warnings
import webbrowser
from dataclasses import dataclass
from pathlib import Path

from redundancy_pin.errors import OutputError, RedundancyPinError
from redundancy_pin.files import write_text
from redundancy_pin.visualisation.html_page import Recorder, page
from redundancy_pin.visualisation.live_view import LiveView, serve_page
from redundancy_pin.visualisation.meshcat_scene import send_scene
from redundancy_pin.visualisation.scene import Scene


@dataclass(frozen=True, eq=False)
class View:
    """A scene that can be looked at. The last expression of a notebook cell shows itself; no display is needed.

    Attributes:
        scene: what is shown.
        forces: whether arrows are shown at first.
        height: of the picture in a notebook, pixels.
    """

    scene: Scene
    forces: bool = True
    height: int = 480

    def html(self) -> str:
        """Return one self-contained HTML page, a megabyte and its meshes: it plays offline, at true speed, in a loop.

        Raises:
            RedundancyPinError: meshcat is not installed.
        """
        require_meshcat()
        import meshcat

        recorder = Recorder()
        send_scene(meshcat.Visualizer(window=recorder), self.scene, forces=self.forces)
        return page(self.scene, recorder.commands, forces=self.forces)

    def save(self, path: str | Path) -> None:
        """Write the page to a file; the same scene gives the same bytes.

        Raises:
            OutputError: the suffix is not .html, or the file cannot be written; an earlier one is as it was.
            RedundancyPinError: meshcat is not installed.
        """
        require_html(path)
        write_text(path, self.html())

    def serve(self, *, open_browser: bool = False) -> LiveView:
        """Show the page at an address of this machine, ``http://127.0.0.1:7000/`` if it is free.

        Args:
            open_browser: whether to open it in the default browser.

        Raises:
            RedundancyPinError: meshcat is not installed, or no port can be opened.
        """
        live = serve_page(self.html())
        if open_browser:
            webbrowser.open(live.url)
        return live

    def _repr_html_(self) -> str:
        """Return the page in a frame, for a notebook."""
        inlined = html.escape(self.html(), quote=True)
        style = f"width: 100%; height: {self.height}px; border: none"
        return f'<iframe srcdoc="{inlined}" style="{style}" title="{html.escape(self.scene.title)}"></iframe>'


def require_html(path: str | Path) -> None:
    """Check that a file is to hold HTML.

    Raises:
        OutputError: its suffix says otherwise.
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise OutputError(
            f"Cannot write {path}: its name does not end in .html.",
            remedy="Give the file the suffix .html.",
            path=str(path),
        )


def require_meshcat() -> None:
    """Check that moving pictures can be made.

    Raises:
        RedundancyPinError: meshcat is not installed.
    """
    try:
        with warnings.catch_warnings():  # it uses a name of pyzmq that is to go
            warnings.simplefilter("ignore", DeprecationWarning)
            import meshcat  # noqa: F401
    except ImportError as error:
        raise RedundancyPinError(
            "Moving pictures need meshcat, which is not installed.",
            remedy="Install it with `pip install 'redundancy_pin[show]'`.",
        ) from error
