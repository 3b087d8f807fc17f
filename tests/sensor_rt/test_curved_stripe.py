"""The stripe on curved surfaces is displaced as the light of a Gaussian sheet predicts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.curvature import ball_errors, predicted


def test_centroid_on_a_small_ball_is_displaced_as_predicted(tmp_path: Path) -> None:
    """-3/2 s² / R, as docs/limits.md states; of the steep sides, where the light is cut off, nothing is said."""
    error, angle = ball_errors(1.0, "centre_of_gravity", np.array([-0.3, 0.0, 0.3]), tmp_path)
    assert error[angle < np.radians(40)].mean() == pytest.approx(predicted(1.0), rel=0.2)
