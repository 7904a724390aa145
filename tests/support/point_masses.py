"""Machines as point masses: positions written down, and Newton's law by central differences."""

from __future__ import annotations

import numpy as np


def newton(points, masses, x, v, a, s, sd, sdd, gravity=0.0):
    """Generalised forces along x and s of masses at points(x, s), (P, 2) or (P, 3); all derivatives by differences."""
    h = 1e-4

    def at(t):
        return points(x + v * t + a * t**2 / 2, s + sd * t + sdd * t**2 / 2)

    acceleration = (at(h) - 2 * at(0.0) + at(-h)) / h**2
    acceleration[:, -1] += gravity
    inertial = np.array(masses)[:, None] * acceleration
    of_x = [(points(x + e, s) - points(x - e, s)) / (2 * h) for e in h * np.eye(len(x))]
    of_s = [(points(x, s + e) - points(x, s - e)) / (2 * h) for e in h * np.eye(len(s))]
    return ([(part * inertial).sum() for part in parts] for parts in (of_x, of_s))


def delta_points(x, s, on):
    """Points of a delta of 0.2, 0.05, 0.25, 0.35 m: platform, each rod's ends and middle (Simpson's rule is exact for
    slender rods), and its carriers; elbows outward."""
    everything = [x]
    for leg in range(3):
        c, d = np.cos(2 * np.pi * leg / 3), np.sin(2 * np.pi * leg / 3)
        to_world = np.array([[c, -d, 0], [d, c, 0], [0, 0, 1]])
        corner = to_world.T @ x + [0.05 - 0.2, 0, 0]
        across = np.arccos((corner @ corner + 0.25**2 - 0.35**2) / (2 * 0.25 * np.hypot(corner[0], corner[2])))
        down = np.arctan2(-corner[2], corner[0]) - across
        elbow = 0.25 * np.array([np.cos(down), 0, -np.sin(down)])
        rod = corner - elbow
        arm_normal = np.array([np.sin(down), 0, np.cos(down)])
        rod_normal = np.array([-rod[2], 0, rod[0]]) / np.hypot(rod[0], rod[2])
        track = elbow + s[leg] * arm_normal if on == "arms" else elbow + rod / 2 + s[leg] * rod_normal
        points = [0 * elbow, elbow / 2, elbow, elbow, elbow + rod / 2, corner, track]
        everything += [to_world @ (point + np.array([0.2, 0, 0])) for point in points]
    return np.array(everything)
