"""The position of the robot when a workspace opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser")

from scancell import Scanner, assets_dir
from scancell.browser.server.workspace import _over_part, _start_over_part

PART = Path(__file__).resolve().parents[2] / "assets" / "parts" / "step_block.stl"


def test_first_profile_is_on_the_part_and_an_arm_that_cannot_get_there_stays_at_home() -> None:
    with Scanner(threads=1) as scanner, scanner.session(PART, guarded=True) as session:
        over_part = _over_part(session.nominal, session.world.setup.sensor)
        _start_over_part(session, over_part + np.array([10.0, 0.0, 0.0]))
        np.testing.assert_allclose(session.joints, session.home, atol=1e-3)
        _start_over_part(session, over_part)
        points = session.profile("geometric").points_in_part
        assert len(points) > 100
        assert points[:, 2].max() > 0.01  # m: on the part, not on the table


def test_first_profile_is_on_a_part_that_the_arm_holds_before_the_sensor() -> None:
    with (
        Scanner(assets_dir() / "cells/held_part.toml", threads=1) as scanner,
        scanner.session(PART, guarded=True) as session,
    ):
        assert _over_part(session.nominal, session.world.setup.sensor) is None
        _start_over_part(session, None)
        assert np.abs(session.joints - session.home).max() > 0.05
        points = session.profile("geometric").points_in_part
        assert len(points) > 100
        assert points[:, 2].max() > 0.01  # m: on the part, not on the chuck


def test_arm_stays_at_home_beside_a_sensor_on_a_post_and_a_part_that_it_does_not_carry() -> None:
    with (
        Scanner(assets_dir() / "cells/belt_post.toml", threads=1) as scanner,
        scanner.session(PART, guarded=True) as session,
    ):
        _start_over_part(session, _over_part(session.nominal, session.world.setup.sensor))
        np.testing.assert_allclose(session.joints, session.home, atol=1e-3)
