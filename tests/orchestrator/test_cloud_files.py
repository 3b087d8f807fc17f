"""PLY files and atomic writing: round trip, other readers, failed writes."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh

from scancell.errors import MeshError, OutputError
from scancell.files import atomic_write
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import read_ply, write_ply


def make_cloud(n: int = 500) -> Cloud:
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(n, 3))
    return Cloud(
        points_in_part=rng.uniform(-0.1, 0.1, (n, 3)) + 10.0,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        sigma=rng.uniform(1e-6, 1e-5, n),
        intensity=rng.uniform(0, 255, n),
        quality=rng.uniform(0, 1, n),
        camera=rng.integers(0, 3, n).astype(np.int32),
        column=rng.integers(0, 1280, n).astype(np.int32),
        profile=np.sort(rng.integers(1, 1300, n)),
        segment=rng.integers(1, 9, n).astype(np.int32),
        time=np.sort(rng.uniform(0, 100, n)),
    )


def test_round_trip(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_ply(tmp_path / "cloud.ply", cloud)
    back = read_ply(tmp_path / "cloud.ply")
    assert np.abs(back.points_in_part - cloud.points_in_part).max() < 1e-14  # double precision, 10 m from the origin
    assert np.array_equal(back.time, cloud.time)
    for name in ("camera", "profile", "segment"):
        assert np.array_equal(getattr(back, name), getattr(cloud, name))
    for name in ("normals", "sigma", "intensity", "quality"):
        assert getattr(back, name) == pytest.approx(getattr(cloud, name), rel=1e-6)


def test_trimesh_reads_millimetres(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_ply(tmp_path / "cloud.ply", cloud, comments=("part: a block\nof steel",))
    seen = trimesh.load(tmp_path / "cloud.ply")
    assert np.asarray(seen.vertices) == pytest.approx(cloud.points_in_part * 1e3, abs=1e-9)
    data = seen.metadata["_ply_raw"]["vertex"]["data"]
    assert data["sigma"] == pytest.approx(cloud.sigma * 1e3, rel=1e-6)
    assert np.array_equal(data["profile"], cloud.profile)


def test_empty_cloud(tmp_path: Path) -> None:
    write_ply(tmp_path / "cloud.ply", make_cloud(0))
    assert len(read_ply(tmp_path / "cloud.ply")) == 0


def test_files_of_equal_clouds_are_identical(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", make_cloud())
    write_ply(tmp_path / "b.ply", make_cloud())
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("damage", ["missing", "empty", "other", "short"])
def test_invalid_file_error(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "cloud.ply"
    if damage != "missing":
        write_ply(path, make_cloud())
        whole = path.read_bytes()
        path.write_bytes({"empty": b"", "other": b"ply\nformat ascii 1.0\nend_header\n", "short": whole[:-9]}[damage])
    with pytest.raises(MeshError, match=r"cloud\.ply"):
        read_ply(path)


def test_selection_and_concatenation() -> None:
    cloud = make_cloud()
    even = np.arange(len(cloud)) % 2 == 0
    parts = [cloud[even], cloud[~even]]
    order = np.argsort(np.concatenate([np.flatnonzero(even), np.flatnonzero(~even)]))
    back = Cloud.concatenate(parts)[order]
    for field in fields(Cloud):
        assert np.array_equal(getattr(back, field.name), getattr(cloud, field.name))


def test_failed_write_keeps_existing_file(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_write(path) as temporary:
        temporary.write_text("half")
        _ = 1 / 0
    with pytest.raises(KeyboardInterrupt), atomic_write(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["figures.json"]


def test_write_replaces_existing_file(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    path.write_text("old")
    with atomic_write(path) as temporary:
        assert temporary.suffix == ".json"
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["figures.json"]


def test_unwritable_path_raises_output_error(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="file"):
        write_ply(tmp_path / "file" / "cloud.ply", make_cloud())
    with pytest.raises(OutputError, match=r"folder\.ply"):
        write_ply(tmp_path / "folder.ply", make_cloud())
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder.ply"]
