"""Shared fixtures: the shipped robots, one a test."""

from __future__ import annotations

import pytest
import zoo

from redundancy_pin.robot import Robot


@pytest.fixture(params=zoo.SHIPPED)
def shipped(request: pytest.FixtureRequest) -> Robot:
    """Each shipped robot in turn, loaded once a session."""
    return zoo.robot_of(request.param)
