"""Objects that the tests of the Python package share because they are costly."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from scancell import Scanner
from scancell.config.loading import load_setup
from scancell.geometry.mesh import Mesh, ReducedMesh, reduced
from scancell.guard import guard
from scancell.planning import model


@pytest.fixture(scope="session", autouse=True)
def _each_body_is_reduced_once() -> Iterator[None]:
    """Guards and planning cells of a process share the reduced meshes of equal bodies, which take a second each."""
    known: dict[tuple[object, ...], ReducedMesh] = {}

    def shared(mesh: Mesh, max_faces: int, max_error: float) -> ReducedMesh:
        key = (mesh.vertices.tobytes(), mesh.faces.tobytes(), mesh.source, max_faces, max_error)
        if key not in known:
            known[key] = reduced(mesh, max_faces, max_error)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        for module in (guard, model):
            patch.setattr(module, "reduced", shared)
        yield


@pytest.fixture(scope="session")
def ideal_scanner() -> Iterator[Scanner]:
    """The default cell without noise."""
    with Scanner(setup=load_setup(ideal=True), threads=1) as made:
        yield made
