"""Expected arrays in messages."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.arguments import Shape, Within


@pytest.mark.parametrize("lengths", [(3,), (2, 3), (4, 4), (1, 2, 3)])
def test_shapes_are_written_as_numpy_writes_them(lengths: tuple[int, ...]) -> None:
    assert str(Shape(lengths)) == f"finite numbers of shape {np.zeros(lengths).shape}"


def test_free_lengths_types_and_limits_are_stated() -> None:
    assert str(Shape((None,))) == "finite numbers of shape (n,)"
    assert str(Shape((None, 3), dtype=int)) == "integers of shape (n, 3)"
    assert str(Shape((None,), finite=False)) == "numbers of shape (n,)"
    assert str(Shape((None,), within=Within(-1.0, 1.0))) == "finite numbers of shape (n,) from -1 to 1"
