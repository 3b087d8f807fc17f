"""Clouds in all formats, read by independent libraries; files are written whole or not at all."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
import trimesh

from scancell.errors import DescriptionError, MeshError, OutputError
from scancell.files import atomic_write
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import FORMATS, parse_formats, read_ply, write_cloud, write_ply
from scancell.reconstruction.cloud_files.formats import WITHOUT_SATURATED, record_of

SAME = ("intensity", "quality", "camera", "column", "segment", "profile", "saturated")


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
        saturated=rng.uniform(size=n) < 0.3,
    )


def near(cloud):
    """The cloud moved to the origin, within 10 cm, for formats of single precision."""
    values = {name: getattr(cloud, name) for name in cloud.__dataclass_fields__}
    return type(cloud)(**{**values, "points_in_part": cloud.points_in_part - 10.0})


@pytest.mark.parametrize("suffix", FORMATS)
def test_files_of_equal_clouds_are_identical(tmp_path: Path, suffix: str) -> None:
    for name in ("a", "b"):
        write_cloud(tmp_path / f"{name}.{suffix}", make_cloud(), ("a block",))
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", FORMATS)
def test_empty_cloud_is_written(tmp_path: Path, suffix: str) -> None:
    write_cloud(tmp_path / f"a.{suffix}", make_cloud(0))
    assert (tmp_path / f"a.{suffix}").stat().st_size > 0


@pytest.mark.parametrize("suffix", FORMATS)
def test_failed_write_leaves_no_file(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="file"):
        write_cloud(tmp_path / "file" / f"a.{suffix}", make_cloud(5))
    (tmp_path / f"folder.{suffix}").mkdir()
    with pytest.raises(OutputError, match=rf"folder\.{suffix}"):
        write_cloud(tmp_path / f"folder.{suffix}", make_cloud(5))
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", f"folder.{suffix}"]


def test_laz_with_laspy(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_cloud(tmp_path / "a.laz", cloud)
    back = laspy.read(tmp_path / "a.laz")
    assert back.header.are_points_compressed
    assert np.abs(back.xyz - cloud.points_in_part * 1e3).max() <= 0.5e-5 + 1e-9  # half a step, 10 m from the origin
    assert np.array_equal(back.gps_time, cloud.time)
    assert np.array_equal(back.intensity, np.rint(cloud.intensity))
    assert back.amplitude == pytest.approx(cloud.intensity, rel=1e-6)
    assert back.sigma == pytest.approx(cloud.sigma * 1e3, rel=1e-6)
    assert np.stack([back.nx, back.ny, back.nz], -1) == pytest.approx(cloud.normals, rel=1e-6)
    assert back.quality == pytest.approx(cloud.quality, rel=1e-6)
    for name in ("camera", "column", "segment", "profile", "saturated"):
        assert np.array_equal(back[name], getattr(cloud, name))


def read_e57(path: Path) -> dict[str, np.ndarray]:
    """All fields, including extensions, which `pye57.E57.read_scan` ignores."""
    with pye57.E57(str(path)) as file:
        header = file.get_header(0)
        buffers, data = pye57.libe57.VectorSourceDestBuffer(), {}
        for name in header.point_fields:
            data[name] = np.empty(header.point_count, float)
            buffers.append(
                pye57.libe57.SourceDestBuffer(file.image_file, name, data[name], len(data[name]), True, True)
            )
        header.points.reader(buffers).read()
    return data


def test_e57_with_pye57(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_cloud(tmp_path / "a.e57", cloud)
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        easy = file.read_scan_raw(0, ignore_unsupported_fields=True)
        assert file.get_header(0).xMinimum == pytest.approx(cloud.points_in_part[:, 0].min(), abs=1e-12)
    assert np.abs(easy["cartesianX"] - cloud.points_in_part[:, 0]).max() == 0, "metres, in double precision"
    assert np.array_equal(easy["columnIndex"], cloud.column)
    assert np.array_equal(np.unique(cloud.profile)[easy["rowIndex"]], cloud.profile), "rows are exposures"
    data = read_e57(tmp_path / "a.e57")
    assert np.array_equal(data["timeStamp"], cloud.time)
    for i, axis in enumerate("XYZ"):
        assert data[f"nor:normal{axis}"] == pytest.approx(cloud.normals[:, i], rel=1e-6)
    for name in ("sigma", "quality", "camera", "segment", "profile", "saturated"):
        assert data[f"scancell:{name}"] == pytest.approx(getattr(cloud, name).astype(float), rel=1e-6)
    assert data["intensity"] == pytest.approx(cloud.intensity, rel=1e-6)


def test_npz_is_lossless(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_cloud(tmp_path / "a.npz", cloud)
    back = np.load(tmp_path / "a.npz")
    assert np.array_equal(back["points_in_part_mm"], cloud.points_in_part * 1e3)
    assert np.array_equal(back["sigma_mm"], cloud.sigma * 1e3)
    assert np.array_equal(back["time_s"], cloud.time)
    for name in ("normals", *SAME):
        assert np.array_equal(back[name], getattr(cloud, name))


def test_xyz_table(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_cloud(tmp_path / "a.xyz", cloud, ("of a block",))
    first, units, remark = (tmp_path / "a.xyz").read_text().splitlines()[:3]
    assert "mm" in units
    assert remark == "# of a block"
    table = dict(zip(first.split()[1:], np.loadtxt(tmp_path / "a.xyz").T, strict=True))
    for i, axis in enumerate("xyz"):
        assert table[axis] == pytest.approx(cloud.points_in_part[:, i] * 1e3, abs=0.51e-6)
        assert table[f"n{axis}"] == pytest.approx(cloud.normals[:, i], rel=1e-6)
    assert table["sigma"] == pytest.approx(cloud.sigma * 1e3, rel=1e-6)
    assert table["time"] == pytest.approx(cloud.time, abs=0.51e-9)
    for name in SAME:
        assert table[name] == pytest.approx(getattr(cloud, name).astype(float), rel=1e-6)


def test_pcd_fields(tmp_path: Path) -> None:
    cloud = near(make_cloud())
    write_cloud(tmp_path / "a.pcd", cloud)
    head, _, body = (tmp_path / "a.pcd").read_bytes().partition(b"DATA binary\n")
    said = {line.split()[0]: line.split()[1:] for line in head.decode().splitlines() if line[0] != "#"}
    letters = {"F": "f", "I": "i", "U": "u"}
    kinds = [f"<{letters[kind]}{size}" for kind, size in zip(said["TYPE"], said["SIZE"], strict=True)]
    table = np.frombuffer(body, np.dtype(list(zip(said["FIELDS"], kinds, strict=True))))
    assert len(table) == int(said["POINTS"][0]) == len(cloud)
    for i, axis in enumerate("xyz"):
        assert np.abs(table[axis] - cloud.points_in_part[:, i] * 1e3).max() < 8e-6
        assert table[f"normal_{axis}"] == pytest.approx(cloud.normals[:, i], rel=1e-6)
    for name in SAME:
        assert table[name] == pytest.approx(getattr(cloud, name).astype(float), rel=1e-6)
    assert np.array_equal(table["time"], cloud.time)


@pytest.mark.parametrize("suffix", ["ply", "pcd", "xyz"])
def test_open3d_reads_points_and_normals(tmp_path: Path, suffix: str) -> None:
    import open3d  # noqa: PLC0415  (takes seconds to import)

    cloud = near(make_cloud())
    write_cloud(tmp_path / f"a.{suffix}", cloud)
    seen = open3d.io.read_point_cloud(str(tmp_path / f"a.{suffix}"))
    assert np.asarray(seen.points) == pytest.approx(cloud.points_in_part * 1e3, abs=1e-5)
    if suffix != "xyz":  # the reader uses three numbers per line
        assert np.asarray(seen.normals) == pytest.approx(cloud.normals, abs=1e-6)
        fields = open3d.t.io.read_point_cloud(str(tmp_path / f"a.{suffix}")).point
        for name in ("intensity", "quality", "sigma", "time") if suffix == "ply" else ("intensity", "quality"):
            assert fields[name].numpy().ravel() == pytest.approx(
                getattr(cloud, name) * (1e3 if name == "sigma" else 1), rel=1e-6
            )


def test_unknown_format_is_rejected() -> None:
    with pytest.raises(DescriptionError, match="format = 'las': expected ply, npz, laz, e57, pcd or xyz"):
        parse_formats("ply, las", "format")
    assert parse_formats("laz,PLY,laz", "format") == ("laz", "ply")


def test_round_trip(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_ply(tmp_path / "cloud.ply", cloud)
    back = read_ply(tmp_path / "cloud.ply")
    assert np.abs(back.points_in_part - cloud.points_in_part).max() < 1e-14  # double precision, 10 m from the origin
    assert np.array_equal(back.time, cloud.time)
    for name in ("camera", "profile", "segment", "saturated"):
        assert np.array_equal(getattr(back, name), getattr(cloud, name))
    for name in ("normals", "sigma", "intensity", "quality"):
        assert getattr(back, name) == pytest.approx(getattr(cloud, name), rel=1e-6)


def test_files_without_saturated_points_are_read(tmp_path: Path) -> None:
    """Files of earlier versions lack the last field."""
    cloud = make_cloud()
    record = record_of(cloud)
    write_ply(tmp_path / "cloud.ply", cloud)
    head, mark, _ = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")
    older = np.empty(len(record), WITHOUT_SATURATED)
    for name in WITHOUT_SATURATED.names or ():
        older[name] = record[name]
    head = head.replace(b"property uchar saturated\n", b"")
    (tmp_path / "older.ply").write_bytes(head + mark + older.tobytes())
    write_cloud(tmp_path / "cloud.npz", cloud)
    with np.load(tmp_path / "cloud.npz") as archive:
        np.savez(tmp_path / "older.npz", **{name: archive[name] for name in archive if name != "saturated"})
    for suffix in ("ply", "npz"):
        new, back = Cloud.load(tmp_path / f"cloud.{suffix}"), Cloud.load(tmp_path / f"older.{suffix}")
        assert new.saturated.any() and not back.saturated.any()
        for field in fields(Cloud):
            if field.name != "saturated":
                assert np.array_equal(getattr(back, field.name), getattr(new, field.name))


def test_trimesh_reads_millimetres(tmp_path: Path) -> None:
    cloud = make_cloud()
    write_ply(tmp_path / "cloud.ply", cloud, comments=("part: a block\nof steel",))
    seen = trimesh.load(tmp_path / "cloud.ply")
    assert np.asarray(seen.vertices) == pytest.approx(cloud.points_in_part * 1e3, abs=1e-9)
    data = seen.metadata["_ply_raw"]["vertex"]["data"]
    assert data["sigma"] == pytest.approx(cloud.sigma * 1e3, rel=1e-6)
    assert np.array_equal(data["profile"], cloud.profile)


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
