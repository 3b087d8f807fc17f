"""Mutated files of clouds and meshes against an independent reader of each format in a child process.

    PYTHONPATH=tests python -m bench.file_mutants OUT.json --judge /venv/bin/python --count 20000

The interpreter of `--judge` has pypcd4 (PCD), NumPy (text), Open3D (meshes of STL and OBJ files) and trimesh (PLY, of
which many files end Open3D by overflows); without it only the own readers are judged: a cloud becomes points whose
number and dropped records make its records, a mesh finite vertices and faces of them, or the file is refused by name;
nothing else is raised, and NumPy warns of nothing. Where both read a file, numbers of records and sums of coordinates,
or numbers and areas of triangles, are compared.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from bench.mesh_files import fan, measured, prism, written
from scancell.errors import ScancellError
from scancell.geometry.mesh import load_mesh
from scancell.geometry.mesh_files import read_mesh
from scancell.reconstruction.cloud_files.read import read_cloud_file

CLOUDS = ("pcd", "xyz")
FORMATS = (*CLOUDS, "stl", "obj", "ply")
_AGREED = 1e-5  # relative difference of sums of coordinates, or of areas
_KEPT = 20  # differing files whose content is kept

_JUDGE = r"""
import json, sys, warnings
import numpy as np
warnings.simplefilter("ignore")
def pcd(path):
    from pypcd4 import PointCloud
    return PointCloud.from_path(path).numpy(("x", "y", "z"))
def xyz(path):
    return np.loadtxt(path, usecols=(0, 1, 2), ndmin=2)
def mesh(path):
    import open3d
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    found = open3d.io.read_triangle_mesh(path)
    if not found.triangles:
        raise ValueError("no triangles")
    return [len(found.triangles), found.get_surface_area()]
def ply(path):
    import trimesh
    found = trimesh.load(path, process=False, force="mesh")
    if not len(found.faces):
        raise ValueError("no triangles")
    return [len(found.faces), float(found.area)]
for line in sys.stdin:
    path = line.strip()
    try:
        if path[-3:] in ("stl", "obj", "ply"):
            print(json.dumps(ply(path) if path.endswith("ply") else mesh(path)), flush=True)
            continue
        points = np.asarray({"pcd": pcd, "xyz": xyz}[path[-3:]](path), float)
        kept = np.isfinite(points).all(1) & (points != 0).any(1)
        print(json.dumps([len(points), float(np.abs(points[kept]).sum())]), flush=True)
    except BaseException as error:
        print(json.dumps([type(error).__name__, str(error)[:80]]), flush=True)
"""


ENCODINGS = {"stl": ("stl_text", "stl_binary"), "obj": ("obj",), "ply": ("ply_text", "ply_binary")}


def seeds(kind: str, rng: np.random.Generator) -> bytes:
    """A valid file of a format in one of its encodings."""
    if kind not in CLOUDS:
        vertices, polygons, _, _ = prism(rng)
        return written(str(rng.choice(ENCODINGS[kind])), [(vertices, fan(polygons, vertices))], rng)
    points = np.round(rng.uniform(-90, 90, (int(rng.integers(2, 30)), 3)), 3)
    if kind == "xyz":
        separator = str(rng.choice([" ", "\t", "  "]))
        rows = [separator.join(f"{v:.3f}" for v in point) for point in points.tolist()]
        return (str(rng.choice(["", "# x y z\n"])) + "\n".join(rows) + "\n").encode()
    size = int(rng.choice([4, 8]))
    more = int(rng.integers(0, 3))
    names, counts = ["x", "y", "z", "a", "b"][: 3 + more], [1, 1, 1, 1, 3][: 3 + more]
    values = np.concatenate([points, rng.uniform(0, 9, (len(points), sum(counts[3:])))], 1)
    encoding = str(rng.choice(["ascii", "binary"]))
    body = values.astype(f"<f{size}").tobytes()
    if encoding == "ascii":
        body = ("\n".join(" ".join(f"{v:.3f}" for v in row) for row in values.tolist()) + "\n").encode()
    words = {"FIELDS": names, "SIZE": [size] * len(names), "TYPE": ["F"] * len(names), "COUNT": counts}
    head = "".join(f"{key} {' '.join(map(str, value))}\n" for key, value in words.items())
    n = len(points)
    head = f"VERSION .7\n{head}WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {encoding}\n"
    return head.encode() + body


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes after one to three changes: of a byte, a cut, a doubled or moved piece, an inserted word."""
    words = (
        b"nan",
        b"\n",
        b" ",
        b"-",
        b"1e999",
        b"0",
        b",",
        b"#",
        b"\r\n",
        b"\0",
        b"9",
        b"x",
        b"\xff",
        b"DATA ascii\n",
        b"f 1 2 3\n",
        b"vertex 1 2 3\n",
        b"endsolid\n",
    )
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        at, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
        match int(rng.integers(0, 5)):
            case 0:
                data = data[:at] + bytes([int(rng.integers(0, 256))]) + data[at + 1 :]
            case 1:
                data = data[:at] + data[min(end, at + 20) :]
            case 2:
                data = data[:end] + data[at:end][:60] + data[end:]
            case 3:
                data = data[:at] + words[int(rng.integers(len(words)))] + data[at:]
            case _:
                data = data[:end]
        if not data:
            return b"\n"
    return data


def own(path: Path) -> tuple[int, float] | tuple[str, str]:
    """Records and sum of the coordinates of the usable points, mm; or the error of the refusal.

    Of a mesh, number of triangles and their area.
    """
    try:
        if path.suffix[1:] not in CLOUDS:
            mesh = load_mesh(path)
            assert np.isfinite(mesh.vertices).all() and mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
            vertices, faces, _ = read_mesh(path)  # before vertices are joined and repeated faces removed
            return len(faces), measured(vertices, faces)[0]
        found = read_cloud_file(path)
    except ScancellError as error:
        assert path.name in str(error), error
        return type(error).__name__, str(error)[:200]
    assert len(found.points) + sum(found.dropped.values()) == found.records, found
    return found.records, float(1e3 * np.abs(found.points).sum())


class Judge:
    """The other readers in a child process, which is started again where a file ends it."""

    def __init__(self, interpreter: str) -> None:
        self._command = [interpreter, "-c", _JUDGE]
        self._child: subprocess.Popen[str] | None = None

    def read(self, path: Path) -> list[object]:
        """Numbers like those of `own`, or the type and text of an error."""
        if self._child is None:
            self._child = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        child = self._child
        assert child.stdin
        assert child.stdout
        child.stdin.write(f"{path}\n")
        child.stdin.flush()
        for line in child.stdout:  # some libraries print there
            if line.startswith("["):
                return list(json.loads(line))
        self.close()
        return ["crash", "the other reader ended"]

    def close(self) -> None:
        if self._child is not None:
            self._child.communicate()
            self._child = None


def campaign(kind: str, count: int, judge: str | None = None, seed: int = 0) -> tuple[Counter[str], list[list[object]]]:
    """Number of files by outcome, and some of the files about which the readers disagree."""
    rng, outcomes, kept = np.random.default_rng([seed, FORMATS.index(kind)]), Counter[str](), list[list[object]]()
    other = None if judge is None else Judge(judge)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a.{kind}"
        for _ in range(count):
            path.write_bytes(mutated(seeds(kind, rng), rng))
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                ours = own(path)
            if other is None:
                outcomes["refused" if isinstance(ours[0], str) else "read"] += 1
                continue
            theirs = other.read(path)
            outcome = compared(ours, theirs)
            outcomes[outcome] += 1
            if outcome in ("differ", "read by own alone") and sum(one[0] == outcome for one in kept) < _KEPT:
                kept.append([outcome, ours, theirs, path.read_bytes().decode("latin-1")])
    if other is not None:
        other.close()
    return outcomes, kept


def compared(ours: tuple[object, object], theirs: list[object]) -> str:
    """Outcome of both readers."""
    if isinstance(ours[0], str) or isinstance(theirs[0], str):
        if isinstance(ours[0], str) and isinstance(theirs[0], str):
            return "refused by both"
        return "refused by own alone" if isinstance(ours[0], str) else "read by own alone"
    same = ours[0] == theirs[0] and abs(ours[1] - theirs[1]) <= _AGREED * max(abs(theirs[1]), 1.0)  # type: ignore[operator,arg-type]
    return "equal" if same else "differ"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--judge", help="interpreter with pypcd4, NumPy and Open3D")
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=FORMATS, nargs="+", default=FORMATS, help="formats")
    arguments = parser.parse_args()
    found = {}
    for kind in arguments.only:
        outcomes, kept = campaign(kind, arguments.count, arguments.judge, arguments.seed)
        found[kind] = {"outcomes": dict(outcomes), "files": kept}
        print(kind, dict(outcomes), flush=True)
        arguments.out.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
