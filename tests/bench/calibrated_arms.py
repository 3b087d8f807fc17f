"""Inverse kinematics of calibrated arms: ``python -m bench.calibrated_arms ur5e.urdf:tool0 panda.urdf:panda_link8:3``.

Needs PYTHONPATH=tests. Each argument is a URDF file, its tip link and the joints to hold. Every origin of a joint is
perturbed: by three angles of up to 0.5 deg, and by three lengths of up to as much of the file's mean link length. The
perturbed file is converted, and poses are made from random joints within the limits by a product of homogeneous
matrices that knows the file only. Two figures are measured: how far the poses of the solutions are from those, and
whether the joints from which a pose was made are among the solutions. The smallest singular value is that of the
Jacobian with lengths in terms of the reach, which is the sum of the distances between the joints' origins.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.nominal.cell import arm_of
from scancell.nominal.from_urdf import robot_from_urdf

Array = NDArray[np.float64]

ANGLE = np.radians(0.5)  # of the perturbations
LIMIT = 1e-3  # smallest singular value below which a pose counts as singular
POSE, OWN = 1e-9, 1e-6  # m and entries of the rotation matrix, rad: what solutions must keep


def homogeneous(rotation: Array, position: Sequence[float] | Array = (0.0, 0.0, 0.0)) -> Array:
    """(4, 4) of a rotation (3, 3) and a position (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix


def about(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit vector by Rodrigues' formula."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew)


def from_origin(xyz: Sequence[float] | Array, rpy: Sequence[float] | Array) -> Array:
    """(4, 4) of an <origin>."""
    x, y, z = np.eye(3)
    return homogeneous(about(z, rpy[2]) @ about(y, rpy[1]) @ about(x, rpy[0]), xyz)


@dataclass(frozen=True)
class Link:
    """A joint of a URDF file: its origin (4, 4), and its axis (3,), zero if it is fixed."""

    origin: Array
    axis: Array


@dataclass
class Tally:
    """Counts and worst values over the poses of an arm; `poses` and `found` by whether they are singular."""

    poses: dict[bool, int] = field(default_factory=lambda: {False: 0, True: 0})
    found: dict[bool, int] = field(default_factory=lambda: {False: 0, True: 0})
    solutions: int = 0
    pose: float = 0.0
    own: float = 0.0
    lost: float = 0.0  # largest of the smallest singular values of poses whose joints were not found
    offset: float = 0.0  # largest length of a converted row, m

    def __str__(self) -> str:
        rows = [
            f"{self.found[kind]} of {self.poses[kind]} own joints found {name} the limit"
            for kind, name in ((False, "above"), (True, "below"))
        ]
        return (
            f"{', '.join(rows)}; worst {1e6 * self.own:.3g} urad; {self.solutions} solutions, worst pose"
            f" {1e9 * self.pose:.3g} nm; largest smallest singular value of lost ones {self.lost:.2g};"
            f" largest length of a row {self.offset:.3g} m"
        )


def chain_of(root: ET.Element, tip: str) -> list[ET.Element]:
    """Elements of the joints between the root and a link."""
    above = {joint.find("child").get("link"): joint for joint in root.iter("joint")}  # type: ignore[union-attr]
    chain: list[ET.Element] = []
    while tip in above:
        chain.insert(0, above[tip])
        tip = str(above[tip].find("parent").get("link"))  # type: ignore[union-attr]
    return chain


def numbers(joint: ET.Element, name: str, key: str, default: str) -> Array:
    element = joint.find(name)
    return np.array([float(word) for word in (default if element is None else element.get(key, default)).split()])


def perturbed(text: str, tip: str, rng: np.random.Generator) -> str:
    """The text of a URDF file with perturbed origins of the joints before `tip`, and without shapes and masses."""
    root = ET.fromstring(text)
    for link in root.iter("link"):
        link[:] = []
    chain = chain_of(root, tip)
    length = ANGLE * float(np.mean([np.linalg.norm(numbers(joint, "origin", "xyz", "0 0 0")) for joint in chain]))
    for joint in chain:
        xyz, rpy = (numbers(joint, "origin", key, "0 0 0") for key in ("xyz", "rpy"))
        origin = joint.find("origin")
        origin = ET.SubElement(joint, "origin") if origin is None else origin
        for key, value in (
            ("xyz", xyz + rng.uniform(-length, length, 3)),
            ("rpy", rpy + rng.uniform(-ANGLE, ANGLE, 3)),
        ):
            origin.set(key, " ".join(repr(float(number)) for number in value))
    return ET.tostring(root, encoding="unicode")


def links_of(text: str, tip: str) -> list[Link]:
    """The chain to `tip` of the text of a URDF file."""
    links = []
    for joint in chain_of(ET.fromstring(text), tip):
        origin = from_origin(*(numbers(joint, "origin", key, "0 0 0") for key in ("xyz", "rpy")))
        axis = numbers(joint, "axis", "xyz", "1 0 0")
        links.append(Link(origin, np.zeros(3) if joint.get("type") == "fixed" else axis / np.linalg.norm(axis)))
    return links


def judged_pose(links: Sequence[Link], q: Array) -> tuple[Array, Array]:
    """Pose (4, 4) of the tip at joints q (n,), and its Jacobian (6, n) with lengths in terms of the reach."""
    frame, angles, points, axes = np.eye(4), iter(q), [], []
    for link in links:
        frame = frame @ link.origin
        if link.axis.any():
            points.append(frame[:3, 3])
            axes.append(frame[:3, :3] @ link.axis)
            frame = frame @ homogeneous(about(link.axis, next(angles)))
    reach = sum(float(np.linalg.norm(link.origin[:3, 3])) for link in links)
    linear = [np.cross(axis, frame[:3, 3] - point) / reach for axis, point in zip(axes, points, strict=True)]
    return frame, np.concatenate([np.array(linear), np.array(axes)], 1).T


def measure(text: str, tip: str, hold: Sequence[int], poses: int, rng: np.random.Generator, tally: Tally) -> None:
    """Convert the text of a URDF file, and add what its inverse kinematics finds at random poses."""
    links = links_of(text, tip)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(text)
        made = robot_from_urdf(file, tip, Path(folder) / "arm.toml", hold=hold)
    arm = arm_of(made.description)
    lower, upper = arm.limits
    q = rng.uniform(lower, upper, (poses, len(arm.joints)))
    for held in arm.held:
        q[:, held.index] = held.values[0]
    judged = [judged_pose(links, row) for row in q]
    free = [index for index in range(len(arm.joints)) if index not in [held.index for held in arm.held]]
    targets = np.array([frame for frame, _ in judged])
    found = arm.ik(targets @ np.linalg.inv(made.flange_from_tip), reference=q)
    tally.offset = max(tally.offset, float(np.abs([arm.column("a"), arm.column("d")]).max()))
    for own, target, solutions, (_, jacobian) in zip(q, targets, found, judged, strict=True):
        smallest = float(np.linalg.svd(jacobian[:, free], compute_uv=False)[-1])
        singular = smallest < LIMIT
        mine = solutions[np.isfinite(solutions).all(-1)]
        gap = float(np.abs(mine - own).max(-1).min(initial=np.inf))
        tally.poses[singular] += 1
        tally.solutions += len(mine)
        for solution in mine:
            tally.pose = max(tally.pose, float(np.abs(judged_pose(links, solution)[0] - target).max()))
        if gap < OWN:
            tally.found[singular] += 1
            tally.own = max(tally.own, gap)
        else:
            tally.lost = max(tally.lost, smallest)


def campaign(text: str, tip: str, hold: Sequence[int], arms: int, poses: int, seed: int = 0) -> Tally:
    """`poses` poses of each of `arms` perturbations of the arm of a URDF file."""
    tally = Tally()
    for number in range(arms):
        rng = np.random.default_rng([seed, number])
        measure(perturbed(text, tip, rng), tip, hold, poses, rng, tally)
    return tally


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m bench.calibrated_arms", description=__doc__)
    parser.add_argument("arms", nargs="+", help="FILE:TIP, or FILE:TIP:JOINT,… with joints to hold")
    parser.add_argument("--perturbations", type=int, default=1000)
    parser.add_argument("--poses", type=int, default=10, help="of each perturbation")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"limit of the smallest singular value: {LIMIT:g}", flush=True)
    for argument in options.arms:
        file, tip, *hold = argument.split(":")
        held = [int(word) for word in ",".join(hold).split(",") if word]
        start = time.process_time()
        tally = campaign(Path(file).read_text(), tip, held, options.perturbations, options.poses, options.seed)
        spent = time.process_time() - start
        print(f"{Path(file).stem}: {options.perturbations} perturbations, {tally}; {spent:.0f} s", flush=True)


if __name__ == "__main__":
    main()
