"""Key frames of meshcat animations: the same tracks as its own ``Animation`` makes, filled from whole arrays.

Times are in seconds of the motion (a frame rate of 1 and frames that need not be whole), so that a motion plays at true
speed whatever its sampling. Every clip spans the whole motion: clips of different length would drift apart in a loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array, BoolArray


def pose_tracks(t: Array, placement: Array) -> list[Any]:
    """Return the tracks of a moving frame; none where it rests.

    Args:
        t: (F,) time, s.
        placement: (F, 4, 4).
    """
    position = placement[:, :3, 3]
    tracks = []
    if not _rests(position):
        tracks.append(_track("position", "vector3", t, position.tolist()))
    if not _rests(placement[:, :3, :3].reshape(len(t), 9)):
        turned = Rotation.from_matrix(placement[:, :3, :3]).as_quat()
        tracks.append(_track("quaternion", "quaternion", t, turned.tolist()))
    return tracks


def scale_tracks(t: Array, scale: Array) -> list[Any]:
    """Return the track of a changing size (F, 3); none where it stays."""
    return [] if _rests(scale) else [_track("scale", "vector3", t, scale.tolist())]


def visible_tracks(t: Array, visible: BoolArray) -> list[Any]:
    """Return the track of what is shown at times only, with a key where it changes, and one at either end."""
    changes = np.flatnonzero(np.diff(visible)) + 1
    keys = np.unique(np.concatenate([[0], changes, [len(t) - 1]]))
    return [_track("visible", "bool", t[keys], [bool(shown) for shown in visible[keys]])]


def clip(tracks: Sequence[Any]) -> Any:
    """Return an animation clip of one object."""
    from meshcat.animation import AnimationClip

    return AnimationClip(tracks={track.name: track for track in tracks}, fps=1)


def _track(name: str, kind: str, t: Array, values: list[Any]) -> Any:
    from meshcat.animation import AnimationTrack

    return AnimationTrack(name, kind, frames=[float(time) for time in t], values=values)


def _rests(values: Array) -> bool:
    return bool(np.abs(values - values[0]).max(initial=0.0) < 1e-12)
