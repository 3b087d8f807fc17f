"""A script as users write them, for type checkers in strict mode; lines with ``error:`` are deliberate mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import scancell
from scancell import deg, mm

PART = Path("bracket.stl")


def scan_and_report(folder: Path) -> float:
    """Scan a part with a misaligned sensor and save the result; returns the RMS deviation, m."""
    with scancell.Scanner(settings={"scan.max_profiles": 200}, threads=2) as scanner:
        plan = scanner.plan(PART)
        result = scanner.scan(PART, engine="geometric", plan=plan, as_built={"tool.x_mm": 0.1}, seed=3)
        print(result.summary())
        files: list[Path] = result.save(folder, ["ply", "npz"])
        plan.save(folder / "plan.json")
    return result.deviation.rms + len(files)


def calibrate(cell: Path) -> scancell.CalibrationReport:
    """Calibrate the tool of a cell and scan with the estimate."""
    report = scancell.calibrate("tool", cell=cell, as_built={"tool.x_mm": 1.0}, seed=1)
    scancell.scan(PART, cell=cell, as_built={"tool.x_mm": 1.0}, estimated=report.estimated)
    return report


def profile_at(height: float) -> scancell.Cloud:
    """A single exposure, and a cloud that is cut, moved and saved."""
    pose = scancell.location(0.0, 0.0, height, rx=180 * deg)
    shot = scancell.shot(PART, pose, engine="ray-traced")
    print(shot.figures["points"], shot.profile.intensity.max())
    cloud = scancell.Cloud.load("cloud.ply")
    upper = cloud[cloud.points_in_part[:, 2] > 10 * mm]
    upper.save("upper.npz")
    return upper


def compare(run: scancell.ScanResult) -> scancell.MeshEvaluation | scancell.ArtefactEvaluation:
    """Compare a scan with its part, and points of any origin with an artefact."""
    found = scancell.evaluate(run)
    points = np.zeros((10, 3))
    exact = scancell.evaluate(points, artefact="sphere.toml", align="best-fit")
    for one in (found, exact):
        print(one.statistics.rms, *one.warnings)
    return exact


def many(parts: list[str | Path]) -> int:
    """Scan parts in ten variants each."""
    batch = scancell.batch(parts, "out", variants=10, engine="geometric", formats=["ply", "e57"])
    failed = [row["scan"] for row in batch.failed]
    return int(batch.figures["scans"]) - len(failed)


def watch(stage: str, done: float, total: float) -> bool:
    """Print progress; False would cancel."""
    print(f"{stage}: {done:g} of {total:g}")
    return True


def drive() -> None:
    """Move the robot of a running cell."""
    with scancell.Scanner() as scanner, scanner.session(PART, guarded=True) as session:
        session.move_joints(session.home, speed=0.5)
        points = session.profile("geometric").points_in_base
        print(points.shape, session.time)
        scancell.LiveCell(session).submit(scancell.MoveJoints(session.home, table_angle=0.2, speed=0.5))


def handle() -> None:
    """Errors say what was wrong."""
    try:
        scancell.scan("missing.stl", progress=watch)
    except scancell.MeshError as error:
        print(error)
    except (scancell.PlanningError, scancell.CancelledError):
        raise
    except scancell.ScancellError as error:
        print("another:", error)


def mistakes(result: scancell.ScanResult) -> None:
    """What a type checker is to find."""
    scancell.scan(PART, engin="geometric")  # error: name
    scancell.scan(PART, engine="raytraced")  # error: value
    scancell.scan(PART, seed="3")  # error: type
    scancell.shot(PART, "0,0,180")  # error: type
    scancell.survey(PART, radius="50")  # error: type
    scancell.calibrate("tool", sede=1)  # error: name
    scancell.shot(PART, scancell.location(0, 0, 1), scan="scan.toml")  # error: name
    scancell.reconstruct("profiles.csv", convention="xzw")  # error: value
    scancell.batch([PART], "out", variants=10, images="yes")  # error: type
    scancell.evaluate(result, align="icp")  # error: value
    scancell.MoveJoints([0.0] * 6, sped=0.5)  # error: name
    scancell.MoveJoints([0.0] * 6, "0.5")  # error: type
    result.cloud[0]  # error: index
    result.clouds  # error: attribute
    result.summary().rms  # error: attribute
    with scancell.Scanner(cel="cell.toml"):  # error: name
        pass
