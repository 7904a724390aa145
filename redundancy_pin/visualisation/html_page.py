"""One HTML file with meshcat's viewer, a scene and its controls inside: opens from disk, asks the network for nothing.

Meshcat's own ``static_html`` needs a running server, applies the commands in whatever order the browser decodes them,
and forbids nothing. Here they are recorded without a server and applied in order, and the page's content security
policy keeps the browser from asking any address.
"""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any

from redundancy_pin.visualisation.meshcat_scene import MESH_OPACITY, solid_path
from redundancy_pin.visualisation.scene import Scene
from redundancy_pin.visualisation.scene_colors import (
    EFFORT_COLORS,
    MARGIN_COLORS,
    ROLE_COLORS,
    ROLE_NAMES,
    margin_labels,
)

_TEMPLATE = Path(__file__).with_name("html_page.html")


class Recorder:
    """Takes the place of meshcat's window: keeps what it is sent instead of passing it to a server.

    Attributes:
        commands: packed messages, in the order they came.
    """

    def __init__(self) -> None:
        self.commands: list[bytes] = []

    def send(self, command: Any) -> None:
        """Keep a command."""
        import umsgpack

        self.commands.append(umsgpack.packb(command.lower()))


def page(scene: Scene, commands: list[bytes], *, forces: bool) -> str:
    """Return the HTML of a scene.

    Args:
        scene: for title and legend.
        commands: packed messages of meshcat, in order.
        forces: whether arrows are shown at first.
    """
    import meshcat

    folder = Path(meshcat.__file__).parent / "viewer"
    viewer = folder / "dist" / "main.min.js"
    encoded = json.dumps([base64.b64encode(command).decode("ascii") for command in commands])
    parts = {
        "TITLE": html.escape(scene.title),
        "LICENSES": _licenses(folder),
        "LEGEND": _legend(scene),
        "CAPTIONS": "".join(f"<div>{html.escape(text)}</div>" for text in scene.captions),
        "CHECKED": "checked" if forces else "",
        "HAS_FORCES": "" if scene.arrows else "hidden",
        "HAS_MESHES": "" if any(solid.shape == "mesh" for solid in scene.solids) else "hidden",
        "MESH_NODES": json.dumps([solid_path(scene, solid) for solid in scene.solids if solid.shape == "mesh"]),
        "MESH_OPACITY": json.dumps(MESH_OPACITY),
        "COMMANDS": encoded,
        "DURATION": json.dumps(scene.duration),
        "FORCE_NODES": json.dumps([f"{item.group}_{item.name.replace('/', '_')}" for item in scene.arrows]),
        # an end tag inside a script would end it; in a string or a pattern the backslash changes nothing
        "VIEWER": viewer.read_text(encoding="utf-8").replace("</script", "<\\/script"),
    }
    text = _TEMPLATE.read_text(encoding="utf-8")
    for name, value in parts.items():  # the viewer last: what it contains is not to be replaced
        text = text.replace(f"@{name}@", value)
    return text


def _licenses(folder: Path) -> str:
    """Return the notices that copies of the viewer have to carry."""
    notices = [folder / "LICENSE", folder / "dist" / "main.min.js.LICENSE.txt"]
    said = "\n".join(notice.read_text(encoding="utf-8") for notice in notices if notice.is_file())
    return f"The viewer in this page is meshcat.\n{said}".replace("--", "- -")


def _legend(scene: Scene) -> str:
    roles = [role for role in ROLE_NAMES if any(solid.role == role for solid in scene.solids)]
    # links have the colours of the URDF where it gives them
    entries = [(ROLE_NAMES[role], ROLE_COLORS[role]) for role in roles if role != "link"]
    groups = {item.group for item in scene.arrows}
    entries += [
        (f"effort of {what}", EFFORT_COLORS[group])
        for group, what in (("main", "main actuators"), ("carrier", "carriers"))
        if group in groups
    ]
    drawn = "".join(_entry(name, color) for name, color in entries)
    margins = "".join(_entry(name, color) for name, color in zip(margin_labels(), MARGIN_COLORS, strict=True))
    colored = "platform, path" if any(item.role == "platform" for item in scene.plates) else "path"
    return f"{drawn}<div class='head'>margin to singularity ({colored})</div>{margins}"


def _entry(name: str, color: str) -> str:
    return f"<div><i style='background:{color}'></i>{html.escape(name)}</div>"
