"""Mutated files of clouds, meshes and URDF against an independent reader of each format in a child process.

    PYTHONPATH=tests python -m bench.file_mutants OUT.json --judge /venv/bin/python --count 20000

The interpreter of `--judge` has pypcd4 (PCD), NumPy (text), Open3D (meshes of STL and OBJ files), trimesh (PLY, of
which many files end Open3D by overflows) and dartpy (URDF); without it only the own readers are judged: a cloud becomes
points whose number and dropped records make its records, a mesh finite vertices and faces of them, a URDF file a cell
that can be loaded and lacks no link without a warning, or the file is refused by name; nothing else is raised, and
NumPy warns of nothing. Where both read a file, numbers of records and sums of coordinates, numbers and areas of
triangles, or numbers of links and sums of their coordinates, are compared.
"""

from __future__ import annotations

import argparse
import copy
import json
import subprocess
import tempfile
import warnings
from collections import Counter
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from bench.mesh_files import fan, measured, prism, written
from scancell.config.cell import CellDescription
from scancell.config.urdf import read_urdf
from scancell.errors import ScancellError
from scancell.geometry.mesh import load_mesh
from scancell.geometry.mesh_files import read_mesh
from scancell.nominal.cell import nominal_cell
from scancell.nominal.from_urdf import robot_from_urdf
from scancell.reconstruction.cloud_files.read import read_cloud_file

CLOUDS = ("pcd", "xyz")
MESHES = ("stl", "obj", "ply")
FORMATS = (*CLOUDS, *MESHES, "urdf")
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
def urdf(path):
    import dartpy
    loader, options = dartpy.utils.DartLoader(), dartpy.utils.DartLoaderOptions()
    options.mDefaultRootJointType = dartpy.utils.DartLoaderRootJointType.FIXED
    loader.setOptions(options)
    tree = loader.parseSkeleton(path)
    if tree is None:
        raise ValueError("refused")
    bodies = list(map(tree.getBodyNode, range(tree.getNumBodyNodes())))
    own = [body for body in bodies if body.getName() not in ("finger", "other", "hose")]
    at = [body.getWorldTransform().translation() for body in own]
    return [len(bodies), float(np.abs(at).sum())]
for line in sys.stdin:
    path = line.strip()
    try:
        if path.endswith("urdf"):
            print(json.dumps(urdf(path)), flush=True)
            continue
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
    if kind == "urdf":
        return urdf_seed(rng)
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


def urdf_seed(rng: np.random.Generator) -> bytes:
    """A URDF file of an arm on a track, a positioner, a gripper with a finger that follows, and a fence."""
    lines = ['<robot name="r"><link name="root"/>']

    def three(span: float) -> str:
        return " ".join(f"{value:.3f}" for value in rng.uniform(-span, span, 3).tolist())

    def joint(parent: str, child: str, kind: str = "revolute", more: str = "") -> str:
        shape = str(rng.choice(['<box size="0.1 0.2 0.3"/>', '<cylinder radius="0.1" length="0.2"/>', ""]))
        geometry = shape and f'<visual><origin xyz="{three(0.1)}"/><geometry>{shape}</geometry></visual>'
        mass = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        limit = "" if kind == "fixed" else '<limit lower="-1.5" upper="2" velocity="2" effort="9"/>'
        lines.append(f'<link name="{child}">{geometry}{mass}</link>')
        lines.append(
            f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{three(0.3)}" rpy="{three(1.5)}"/><axis xyz="{three(1.0)}"/>{limit}{more}</joint>'
        )
        return child

    link = joint(joint("root", "slide", "prismatic"), "base", "fixed")
    for number in range(1, 6):
        link = joint(link, f"arm{number}")
    joint(link, "tip", "fixed")
    joint("tip", "finger", "prismatic")
    joint("tip", "other", "prismatic", '<mimic joint="to_finger" multiplier="-1"/>')
    joint("base", "hose", "revolute", '<mimic joint="to_arm2" multiplier="0.5" offset="0.1"/>')
    joint(joint("root", "tilt"), "table", "continuous")
    joint("root", "fence", "fixed")
    return "\n".join([*lines, "</robot>"]).encode()


_URDF_WORDS = (
    *(
        "prismatic",
        "fixed",
        "continuous",
        "revolute",
        "planar",
        "",
        "root",
        "arm2",
        "to_arm3",
        "finger",
        "tip",
        "\u00e9",
    ),
    *("nan", "inf", "1e999", "1e-99999999999999999999", "1e300", "-1e6", "0", "0 0 0", "0 0 1", "-1", "1_0", "1 2 3 4"),
)


def mutated_urdf(data: bytes, rng: np.random.Generator) -> bytes:
    """The file after one to three changes: of an attribute, or of an element, which is removed, repeated or moved."""
    if rng.random() < 0.1:
        return mutated(data, rng)
    root = ElementTree.fromstring(data)
    for _ in range(int(rng.integers(1, 4))):
        elements = [(parent, child) for parent in root.iter() for child in parent]
        (parent, child), (other, _) = (elements[int(i)] for i in rng.integers(0, len(elements), 2))
        match int(rng.integers(0, 8)):
            case 0:
                parent.remove(child)
            case 1:
                other.append(copy.deepcopy(child))
            case 2 if child not in list(other.iter()):
                child.append(
                    ElementTree.Element("mimic", {"joint": str(rng.choice(["to_arm1", "to_slide", "to_other"]))})
                )
            case _ if child.attrib:
                key, word = str(rng.choice(list(child.attrib))), str(rng.choice(_URDF_WORDS))
                words = child.attrib[key].split()
                if len(words) > 1 and rng.random() < 0.5:
                    words[int(rng.integers(len(words)))] = word
                    word = " ".join(words)
                child.set(key, word)
    return ElementTree.tostring(root)


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

    Of a mesh, number of triangles and their area; of a URDF file, number of links and sum of their coordinates, m.
    """
    try:
        if path.suffix == ".urdf":
            return own_urdf(path)
        if path.suffix[1:] in MESHES:
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


def own_urdf(path: Path) -> tuple[int, float]:
    """Number of links, and sum of the coordinates of those that stand or move by themselves, every joint at 0, m."""
    made = robot_from_urdf(path, "tip", path.with_name("arm.toml"), cell=path.with_name("cell.toml"), table="table")
    nominal = nominal_cell(CellDescription.from_toml(path.with_name("cell.toml")), None)
    assert np.isfinite(nominal.body_poses(nominal.start)).all()
    links = [link for body in read_urdf(path, "tip", table="table").bodies for link in body.links.values()]
    said = " ".join(made.warnings)
    left = {str(link.get("name")) for link in ElementTree.parse(path).getroot().findall("link")}
    left -= {link.name for link in links}
    assert all(f"'{name}'" in said for name in left), (left, said)
    at = [link.root_from_link[:3, 3] for link in links if link.name not in ("finger", "other", "hose")]
    return len(links) + len(left), float(np.abs(at).sum())


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
            with suppress(ValueError):
                found = json.loads(line)
                if isinstance(found, list):
                    return found
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
            path.write_bytes((mutated_urdf if kind == "urdf" else mutated)(seeds(kind, rng), rng))
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
