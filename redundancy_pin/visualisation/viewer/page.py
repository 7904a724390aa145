"""One HTML file with meshcat's viewer, a scene and its controls inside: opens from disk, asks the network for nothing.

Meshcat's own ``static_html`` needs a running server, applies the commands in whatever order the browser decodes them,
and forbids nothing. Here they are recorded without a server and applied in order, and the page's content security
policy keeps the browser from asking any address.
"""

from __future__ import annotations

import base64
import html
import logging
import math
import os
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import jinja2

from redundancy_pin.arrays import Array
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.io.files import require_suffix, write_text
from redundancy_pin.robot.scales import effort_unit
from redundancy_pin.visualisation.viewer.meshcat_scene import (
    arrow_path,
    import_meshcat,
    send_animation,
    send_scene,
    solid_path,
)
from redundancy_pin.visualisation.viewer.scene import (
    EFFORT_COLORS,
    MARGIN_COLORS,
    UNKNOWN_COLOR,
    Scene,
    margin_classes,
    margin_labels,
)
from redundancy_pin.visualisation.viewer.solids import MESH_OPACITY, ROLE_COLORS, ROLE_NAMES

PORT = 7000  # where the page is if the port is free; else the system chooses one
HERE = "127.0.0.1"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class View:
    """A scene to show. As the last expression of a notebook cell it shows itself; no display is needed.

    Attributes:
        scene: the scene.
        forces: whether arrows are shown at first.
        height: of the picture in a notebook, pixels.
    """

    scene: Scene
    forces: bool = True
    height: int = 480

    def html(self) -> str:
        """Return one self-contained HTML page, a megabyte and meshes: it plays offline, at true speed, in a loop."""
        recorder = _Recorder()
        viewer = import_meshcat().Visualizer(window=recorder)
        send_scene(viewer, self.scene, forces=self.forces)
        send_animation(viewer, self.scene)
        return _page(self.scene, recorder.commands, forces=self.forces)

    def save(self, path: str | Path) -> None:
        """Write the page to a file.

        Raises:
            OutputError: the suffix is not .html, or the file cannot be written; an earlier one is as it was.
        """
        require_html(path)
        write_text(path, self.html())

    def serve(self, *, open_browser: bool = False) -> LiveView:
        """Show the page at an address of this machine, ``http://127.0.0.1:7000/`` if it is free.

        Args:
            open_browser: whether to open it in the default browser.

        Raises:
            RedundancyPinError: no port can be opened.
        """
        live = LiveView(self.html())
        if open_browser:
            webbrowser.open(live.url)
        return live

    def _repr_html_(self) -> str:
        """Return the page in a frame, for a notebook."""
        inlined = html.escape(self.html(), quote=True)
        style = f"width: 100%; height: {self.height}px; border: none"
        return f'<iframe srcdoc="{inlined}" style="{style}" title="{html.escape(self.scene.title)}"></iframe>'


class _Recorder:
    """Takes the place of meshcat's window: keeps packed messages, in order, instead of passing them to a server."""

    def __init__(self) -> None:
        self.commands: list[bytes] = []

    def send(self, command: Any) -> None:
        import umsgpack

        self.commands.append(umsgpack.packb(command.lower()))


def _page(scene: Scene, commands: Sequence[bytes], *, forces: bool) -> str:
    """Return the HTML of a scene from meshcat's packed messages, in order."""
    folder = Path(import_meshcat().__file__).parent / "viewer"
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False}
    words = {"main": "effort of main actuators", "carrier": "effort of carriers"}
    # links have the colours of the URDF where it gives them
    roles = [(name, ROLE_COLORS[r]) for r, name in ROLE_NAMES.items() if r in {s.role for s in scene.solids} - {"link"}]
    groups = [(words[g], color) for g, color in EFFORT_COLORS.items() if g in {arrow.group for arrow in scene.arrows}]
    # an end tag inside a script would end it; in a string or a pattern the backslash changes nothing
    viewer = (folder / "dist" / "main.min.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
    return environment.from_string(Path(__file__).with_name("page.html").read_text(encoding="utf-8")).render(
        scene=scene,
        forces=forces,
        roles=roles + groups,
        margins=list(zip(margin_labels(), MARGIN_COLORS, strict=True)),
        licenses=_licenses(folder),
        viewer=viewer,
        data=_data(scene),
        commands=[base64.b64encode(command).decode("ascii") for command in commands],
    )


def _data(scene: Scene) -> dict[str, Any]:
    """Return what the page's own script reads, plain and by paths in meshcat's tree.

    Positions and efforts of the joints over the frames, which parts of the picture belong to which joint, which have
    the colour of the margin, and that colour over the frames.
    """
    of_body = {joint.body: i for i, joint in enumerate(scene.joints)}
    of_name = {f"joint_{joint.name}": i for i, joint in enumerate(scene.joints)}
    parts = [(solid_path(scene, solid), of_name.get(solid.name, of_body.get(solid.body))) for solid in scene.solids]
    joints = [
        {
            "name": joint.name,
            "kind": ROLE_NAMES[joint.role],
            "unit": "rad" if joint.turning else "m",
            "position": _digits(joint.position),
            "effort": None if joint.effort is None else _digits(joint.effort),
            "effort_unit": effort_unit([joint.turning]),
        }
        for joint in scene.joints
    ]
    colors = [*MARGIN_COLORS, UNKNOWN_COLOR]
    return {
        "readings": {"t": _digits(scene.t), "joints": joints, "parts": [each for each in parts if each[1] is not None]},
        "margins": {
            "parts": [solid_path(scene, solid) for solid in scene.solids if solid.role == "platform"],
            "colors": colors,
            "classes": (margin_classes(scene.margin) % len(colors)).tolist(),
        },
        "arrows": [arrow_path(arrow) for arrow in scene.arrows],
        "meshes": [solid_path(scene, solid) for solid in scene.solids if solid.shape == "mesh"],
        "mesh_opacity": MESH_OPACITY,
    }


def _digits(values: Array) -> list[float | None]:
    """Return values with six digits, which is what a reader sees; None where there are none."""
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in values.tolist()]


def _licenses(folder: Path) -> str:
    """Return the notices that copies of the viewer have to carry."""
    notices = [folder / "LICENSE", folder / "dist" / "main.min.js.LICENSE.txt"]
    text = "\n".join(notice.read_text(encoding="utf-8") for notice in notices if notice.is_file())
    return f"The viewer in this page is meshcat.\n{text}".replace("--", "- -")  # -- would end the comment


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        page: bytes = self.server.page  # type: ignore[attr-defined]
        if self.path.partition("?")[0] != "/":
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(page)))
        self.send_header("Cache-Control", "no-store")  # the next view may have the same address
        self.end_headers()
        self.wfile.write(page)

    def log_message(self, format: str, *args: Any) -> None:
        _LOG.debug(format, *args)


class LiveView(ThreadingHTTPServer):
    """A server that shows one page to browsers of this machine, at ``PORT`` if it is free.

    Args:
        text: the HTML.

    Raises:
        RedundancyPinError: no port can be opened.
    """

    allow_reuse_address = os.name == "posix"  # elsewhere it would share a port that someone listens on

    def __init__(self, text: str) -> None:
        self.page = text.encode("utf-8")
        try:
            super().__init__((HERE, PORT), _Handler)
        except OSError:  # taken, by another view as a rule
            try:
                super().__init__((HERE, 0), _Handler)
            except OSError as error:
                message = f"No port of {HERE} can be opened for the view: {error}."
                raise RedundancyPinError(message, remedy="Write a file instead (--html, View.save).") from error
        self._thread = Thread(target=self.serve_forever, name="redundancy_pin view", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where to look."""
        return f"http://{HERE}:{self.server_address[1]}/"

    def wait(self) -> None:
        """Wait until the server is closed or Ctrl-C is pressed."""
        self._thread.join()

    def close(self) -> None:
        """End the server. Pages that are open stay as they are."""
        self.shutdown()
        self.server_close()
        self._thread.join()


def require_html(path: str | Path) -> None:
    """Check that the name of a file ends in .html."""
    require_suffix(path, (".html", ".htm"))
