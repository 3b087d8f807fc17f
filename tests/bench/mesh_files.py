"""Mesh files of exact area and volume, and what scancell reads of them.

    PYTHONPATH=tests python -m bench.mesh_files [COUNT]

Prisms over convex and concave polygons with holes, several solids in a file, as text and binary files with different
encodings, line ends and forms of numbers. Area and volume follow from closed formulas.
"""

from __future__ import annotations

import struct
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from scancell.errors import MeshError
from scancell.geometry.mesh_files import read_mesh

KINDS = ("stl_text", "stl_binary", "obj", "ply_text", "ply_binary")
TOLERANCE = 1e-6


def prism(rng: np.random.Generator) -> tuple[np.ndarray, list[list[int]], float, float]:
    """Vertices, polygons, area (mm²) and volume (mm³) of a prism over a star-shaped polygon, or one with a hole."""
    corners = int(rng.integers(3, 12))
    angle = (np.arange(corners) + rng.uniform(-0.35, 0.35, corners)) * 2 * np.pi / corners
    radius = 30 * (np.ones(corners) if rng.random() < 0.3 else rng.uniform(0.25, 1, corners))
    outline = np.round(np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1), 3)
    height = round(float(rng.uniform(5, 40)), 3)
    rings = [outline]
    if rng.random() < 0.3:
        # A hole around the middle, which a bridge from corner 0 reaches: both see each other along the ray.
        even = np.arange(corners) * 2 * np.pi / corners  # the hole lies within the outline
        outline[:] = np.round(30 * np.stack([np.cos(even), np.sin(even)], 1), 3)
        rings.append(np.round(outline[::-1] * 0.1, 3))
    if rng.random() < 0.3:  # a corner within an edge
        rings[0] = np.insert(outline, 1, (outline[0] + outline[1]) / 2, axis=0)
    flat = np.concatenate(rings)
    cap = list(range(len(rings[0])))
    if len(rings) == 2:
        first, count = len(rings[0]), len(rings[1])
        hole = [first + (count - 1 + k) % count for k in range(count)]
        cap = [*cap, 0, hole[0], *hole[1:], hole[0]]
    n = len(flat)
    vertices = np.concatenate([np.c_[flat, np.zeros(n)], np.c_[flat, np.full(n, height)]])
    polygons = [cap[::-1], [k + n for k in cap]]
    area = volume = 0.0
    at = 0
    for ring in rings:
        m = len(ring)
        polygons += [[at + k, at + (k + 1) % m, at + (k + 1) % m + n, at + k + n] for k in range(m)]
        at += m
        x, y = ring.T
        signed = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
        area += 2 * signed + height * float(np.linalg.norm(np.roll(ring, -1, 0) - ring, axis=1).sum())
        volume += signed * height
    return vertices, polygons, area, volume


def fan(polygons: list[list[int]], vertices: np.ndarray) -> list[list[int]]:
    """Triangles whose signed areas add up to those of the polygons: for volumes of files without polygons."""
    from scancell.geometry.polygons import triangulated  # noqa: PLC0415

    corners = np.concatenate([np.array(p) for p in polygons])
    return triangulated(vertices, corners, np.array([len(p) for p in polygons]))[0].tolist()


def number(rng: np.random.Generator) -> str:
    """A format of numbers that keeps six decimals."""
    return str(rng.choice(["{:.6f}", "{:.9e}", "{:+.6f}", "{!r}", "{:.10G}"]))


def written(kind: str, solids: list[tuple[np.ndarray, list[list[int]]]], rng: np.random.Generator) -> bytes:
    """The file of several solids."""
    form = number(rng)

    def text(values: np.ndarray | list[float]) -> str:
        return " ".join(form.format(float(value)) for value in values)

    end = str(rng.choice(["\n", "\r\n", "\r"]))
    name = str(rng.choice(["part", "vertex_cover", "T\xfcr 1", "end_header", "facet", ""]))
    starts = np.cumsum([0, *(len(v) for v, _ in solids)]).tolist()
    vertices = np.concatenate([v for v, _ in solids])
    polygons = [[k + at for k in p] for (_, ps), at in zip(solids, starts, strict=False) for p in ps]
    if kind == "stl_binary":
        faces = vertices[np.array(fan(polygons, vertices))].astype("<f4")
        body = b"".join(bytes(12) + face.tobytes() + b"\0\0" for face in faces)
        return b"solid part".ljust(80, b" ") + struct.pack("<I", len(faces)) + body
    if kind == "stl_text":
        lines = []
        for v, ps in solids:
            lines += [f"solid {name}"]
            for face in fan(ps, v):
                lines += ["  facet normal 0 0 0", "    outer loop"]
                lines += [f"      vertex {text(v[k])}" for k in face] + ["    endloop", "  endfacet"]
            lines += [f"endsolid {name}"]
        content = end.join(lines) + end
        return encoded(content.upper() if rng.random() < 0.2 else content, rng)
    if kind == "obj":
        lines, relative = [f"# {name}", f"mtllib {name}"], rng.random() < 0.3
        for (v, ps), at in zip(solids, starts, strict=False):
            lines += [f"o {name}"] + [f"v {text(p)}" + ("  # corner" if rng.random() < 0.05 else "") for p in v]
            for p in ps:
                refs = [str(k - len(v)) if relative else str(k + at + 1) for k in p]
                joint = f" \\{end}" if rng.random() < 0.1 else " "
                lines += ["f " + joint.join(r + ("//1" if rng.random() < 0.1 else "") for r in refs)]
        return encoded(end.join(lines) + end, rng)
    order = "ascii" if kind == "ply_text" else str(rng.choice(["binary_little_endian", "binary_big_endian"]))
    length, index = str(rng.choice(["uchar", "ushort", "int"])), str(rng.choice(["int", "uint", "ushort"]))
    head = ["ply", f"format {order} 1.0", f"comment {name}", f"element vertex {len(vertices)}"]
    head += [f"property double {axis}" for axis in "xyz"] + [f"element face {len(polygons)}"]
    head += [f"property list {length} {index} vertex_indices", "end_header"]
    if kind == "ply_text":
        rows = [text(v) for v in vertices] + [" ".join(map(str, [len(p), *p])) for p in polygons]
        return encoded(end.join([*head, *rows]) + end, rng)
    mark = ">" if "big" in order else "<"
    codes = {"uchar": "B", "ushort": "H", "int": "i", "uint": "I"}
    body = b"".join(struct.pack(f"{mark}{codes[length]}{len(p)}{codes[index]}", len(p), *p) for p in polygons)
    return (end.join(head) + end).encode("latin-1") + vertices.astype(mark + "f8").tobytes() + body


def encoded(text: str, rng: np.random.Generator) -> bytes:
    """The text in one of the encodings that programs write."""
    return text.encode(str(rng.choice(["latin-1", "utf-8", "utf-8-sig", "utf-16"], p=[0.4, 0.3, 0.2, 0.1])))


def measured(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, float]:
    """Area and volume of triangles."""
    corners = np.asarray(vertices, float)[faces].reshape(-1, 3, 3)
    corners = corners - (corners[0, 0] if len(corners) else 0)
    a, b, c = corners.transpose(1, 0, 2)
    with np.errstate(all="ignore"):  # coordinates of damaged files may be of any size
        volume = float(np.linalg.det(corners).sum() / 6)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2), volume


def generated(count: int, seed: int = 0) -> dict[str, int]:
    """Outcomes of `count` generated files; raises `AssertionError` at a wrong area or volume."""
    outcomes: Counter[str] = Counter()
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for case in range(count):
            rng = np.random.default_rng([seed, case])
            kind = KINDS[case % len(KINDS)]
            made = [prism(rng) for _ in range(int(rng.integers(1, 4)))]
            path = Path(folder) / f"a.{kind[:3]}"
            solids = [(v + np.array([100.0 * k, 0, 0]), ps) for k, (v, ps, _, _) in enumerate(made)]
            path.write_bytes(written(kind, solids, rng))
            try:
                vertices, faces, remarks = read_mesh(path)
            except MeshError as error:
                outcomes[f"{kind} refused"] += 1
                print(f"case {case}, {kind}: {error}")
                continue
            exact_values = sum(m[2] for m in made), sum(m[3] for m in made)
            for name, value, exact in zip(("area", "volume"), measured(vertices, faces), exact_values, strict=True):
                error = abs(value / exact - 1)
                worst = max(worst, error)
                assert error < TOLERANCE, f"case {case}, {kind}: {name} {value}, exactly {exact}"
            assert not remarks, remarks
            outcomes[f"{kind} read"] += 1
    print(f"largest relative error {worst:.1e}")
    return dict(sorted(outcomes.items()))


if __name__ == "__main__":
    print(generated(int(sys.argv[1]) if len(sys.argv) > 1 else 200))
