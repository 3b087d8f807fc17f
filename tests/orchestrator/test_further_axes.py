"""Axes beside joints and table: motions and true poses in the FMU, and scans with exact parts, against the tree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import block, cell_file, export_mm

from scancell import (
    CommandError,
    DescriptionError,
    LiveCell,
    LivePlan,
    Operation,
    Plan,
    PlanningError,
    Scanner,
    assets_dir,
    load_part,
    load_setup,
    nominal_cell,
)
from scancell.geometry import pose
from scancell.views.motion import scan_motion

# A tilted track on which a turning column carries the arm, and a positioner: all three further axes.
STACKED = """
[[axis]]
name = "rail"
kind = "prismatic"
along = "y"
pose = { x_mm = -30.0, z_mm = 20.0, rz_deg = 4.0 }
min_mm = -500.0
max_mm = 700.0
max_speed_mm_s = 400.0
max_acceleration_mm_s2 = 900.0

[[axis]]
name = "column"
kind = "revolute"
moves_with = "rail"
pose = { x_mm = 30.0, z_mm = -20.0, rz_deg = -4.0 }
min_deg = -40.0
max_deg = 40.0
max_speed_deg_s = 40.0
max_acceleration_deg_s2 = 90.0

[[axis]]
name = "lift"
kind = "prismatic"
min_mm = -50.0
max_mm = 120.0
max_speed_mm_s = 100.0
max_acceleration_mm_s2 = 300.0
"""


def true_pose(session, frame: str) -> np.ndarray:
    return session.snapshot(1e-4).truth_at_middle(frame)[0]


def test_true_poses_are_those_of_the_tree_while_all_axes_move(tmp_path) -> None:
    settings = ['cell.robot_moves_with="column"', 'cell.table.moves_with="lift"']
    setup = load_setup(cell_file(tmp_path, STACKED), settings=settings)
    rng = np.random.default_rng(4)
    with Scanner(setup=setup) as scanner, scanner.session() as session:
        nominal = session.nominal
        assert nominal.axes[-4:] == ("table", "rail", "column", "lift")
        frames = ("link[1]", "link[6]", "sensor", "table", "rail", "column", "lift")
        for _ in range(4):
            session.start_move_joints(session.home + rng.uniform(-0.2, 0.2, 6), float(rng.uniform(-3, 3)))
            session.wait(0.1)
            for name, low, high in (("rail", -0.3, 0.4), ("column", -0.5, 0.5), ("lift", -0.05, 0.1)):
                session.move_axis(name, float(rng.uniform(low, high)), speed=float(rng.uniform(0.3, 1)))
            axes = session.cell.get(session.cell.real_group(session.cell.axis_names("truth."))).copy()
            expected = nominal.tree.place(axes)
            for frame in frames:
                name = f"axis_frame.{frame}" if frame in ("rail", "column", "lift") else frame
                assert true_pose(session, name) == pytest.approx(expected[frame], abs=1e-12), frame
        assert session.further_axes == pytest.approx(axes[-3:], abs=1e-12)


@pytest.mark.parametrize("cell", ["track", "tilt_turn"])
def test_axis_moves_alone_within_its_limits(cell: str) -> None:
    setup = load_setup(assets_dir() / f"cells/{cell}.toml")
    (axis,) = nominal_cell(setup.cell, None).further_axes
    with Scanner(setup=setup) as scanner, scanner.session() as session:
        rest = session.commanded
        rates = []
        group = session.cell.real_group([f"measured.axis_rate.{axis.name}"])
        session.cell.on_step(lambda: rates.append(float(session.cell.get(group)[0])))
        session.move_axis(axis.name, axis.max)
        assert session.commanded[-1] == axis.max
        assert np.array_equal(session.commanded[:-1], rest[:-1])
        assert 0.9 * axis.max_speed < max(rates) <= axis.max_speed * (1 + 1e-9)
        with pytest.raises(CommandError, match=f"the axis {axis.name}"):
            session.move_axis(axis.name, axis.max + 0.01)
        with pytest.raises(DescriptionError, match=f"name = 'rail': expected {axis.name}"):
            session.move_axis("rail", 0.0)


@pytest.mark.parametrize(("cell", "start"), [("track", -400), ("tilt_turn", 50)])
def test_exact_part_is_measured_without_error_wherever_the_axis_rests(cell: str, start: float) -> None:
    unit = {"track": "mm", "tilt_turn": "deg"}[cell]
    setup = load_setup(
        assets_dir() / f"cells/{cell}.toml",
        settings=[f"cell.axis[1].start_{unit}={start}", "scan.max_profiles=60"],
        ideal=True,
    )
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(assets_dir() / "artefacts/cone.toml", engine="geometric")
    assert len(result.cloud) > 50_000
    assert result.evaluate().deviation.rms < 0.1e-6
    measured = result.recording.measured
    assert measured.names[-1] == setup.cell.axis[0].name
    assert np.ptp(measured.axes[:, -1]) == 0.0
    # Pictures show the cell where the axis rests, also before the first exposure.
    at_start = scan_motion(result.nominal, result.recording, result.plan).frames(0.0)
    for frame, placed in result.nominal.tree.place(result.nominal.start).items():
        if frame in at_start:
            assert at_start[frame] == pytest.approx(placed, abs=1e-9), frame
    assert measured.names[-1] in at_start


def test_deviations_as_built_displace_what_an_axis_carries() -> None:
    setup = load_setup(assets_dir() / "cells/track.toml")
    by = {"x": 0.3e-3, "y": -0.2e-3, "z": 0.5e-3, "rx": 1e-3, "ry": -2e-3, "rz": 0.7e-3}
    as_built = {
        f"axis.track.{key}_{'deg' if key[0] == 'r' else 'mm'}": np.degrees(v) if key[0] == "r" else 1e3 * v
        for key, v in by.items()
    }
    nominal = nominal_cell(setup.cell, None)
    (axis,) = nominal.further_axes
    at_0 = axis.joint.parent_from_joint @ axis.joint.joint_from_frame
    built = at_0 @ pose.from_euler_xyz([by[key] for key in ("x", "y", "z")], [by[key] for key in ("rx", "ry", "rz")])
    joint = replace(axis.joint, parent_from_joint=built @ pose.inverse(axis.joint.joint_from_frame))
    true = replace(nominal, further_axes=(replace(axis, joint=joint),))
    with Scanner(setup=setup) as scanner, scanner.session(as_built=as_built) as session:
        session.move_axis("track", 0.4)
        axes = session.cell.get(session.cell.real_group(session.cell.axis_names("truth."))).copy()
        for frame in ("sensor", "link[3]", "table"):
            assert true_pose(session, frame) == pytest.approx(true.world_from(frame, axes), abs=1e-12)
        assert true_pose(session, "axis_frame.track") == pytest.approx(true.world_from("track", axes), abs=1e-12)
        moved = true_pose(session, "sensor")[:3, 3] - nominal.world_from("sensor", axes)[:3, 3]
        assert 0.3e-3 < np.linalg.norm(moved) < 3e-3


def test_saved_plan_is_refused_where_the_axis_starts_elsewhere(tmp_path) -> None:
    part, cell = load_part(assets_dir() / "parts/sphere_on_foot.stl"), assets_dir() / "cells/track.toml"
    words = ["scan.max_profiles=30", "cell.axis[1].start_mm=40"]
    with Scanner(setup=load_setup(cell, settings=words)) as scanner:
        file = scanner.plan(part).save(tmp_path / "plan.json")
        assert Plan.load(file).program.further == (0.04,)
        again = scanner.scan(part, engine="geometric", plan=file)
        assert np.all(again.recording.measured.axes[:, -1] == 0.04)
    with (
        Scanner(setup=load_setup(cell, settings=words[:1])) as scanner,
        pytest.raises(
            DescriptionError, match=r"further = \[0\.04\]: expected \[0\.0\], where the further axes of the cell start"
        ),
    ):
        scanner.scan(part, engine="geometric", plan=file)


def test_track_shakes_an_arm_with_motors_and_scans_know_where_its_links_were() -> None:
    settings = ['cell.robot.drive="dynamic"', "cell.axis[1].max_acceleration_mm_s2=3000", "scan.max_profiles=40"]
    setup = load_setup(assets_dir() / "cells/track.toml", settings=settings)
    with Scanner(setup=setup) as scanner:
        with scanner.session() as session:
            names = [[f"{group}q[{i}]" for i in range(1, 7)] for group in ("truth.", "measured.")]
            true, measured = (session.cell.real_group(group) for group in names)
            sag = session.cell.get(true).copy() - session.home
            away = []
            session.cell.on_step(lambda: away.append(session.cell.get(true) - session.cell.get(measured) - sag))
            session.move_axis("track", 0.3)
            session.wait(1.0)
        assert np.abs(away).max() > 3e-6
        assert np.abs(away[-1]).max() < np.abs(away).max()  # what friction of the gears holds stays
        assert np.abs(away[-1] - away[-5]).max() < 1e-9
        result = scanner.scan(assets_dir() / "artefacts/cone.toml", engine="geometric")
    sagged = result.evaluate().deviation.rms
    assert 1e-6 < sagged < 1e-3  # encoders of the motors do not know the sag of the gears


def test_jogs_move_an_axis_as_far_as_its_limit() -> None:
    with Scanner(setup=load_setup(assets_dir() / "cells/track.toml")) as scanner, scanner.session() as session:
        session.set_operation(Operation.MANUAL)
        rest = session.commanded
        session.jog_joints([0, 0, 0, 0, 0, 0, 0, 1.0], 2.0)
        reached = session.commanded
        assert reached[-1] > 0.02
        assert np.array_equal(reached[:-1], rest[:-1])
        session.jog_sensor([0, 0, 0.5, 0, 0, 0], 0.5)
        assert session.commanded[-1] == reached[-1]


@pytest.mark.parametrize("tilt", [0, 25])
def test_planner_keeps_clear_of_an_obstacle_on_an_axis(tmp_path, tilt: int) -> None:
    """A clamp on the tilting frame, 14 mm beside the part, which the corners of the turning part come near to."""
    file = export_mm(block(0.03, 0.02, 0.03), tmp_path / "clamp.stl")
    place = "pose = { y_mm = 34, z_mm = -100 }"
    clamp = f'cell.obstacle=[{{ name = "clamp", mesh = "{file}", moves_with = "tilt", {place} }}]'
    setup = load_setup(assets_dir() / "cells/tilt_turn.toml", settings=[clamp, f"cell.axis[1].start_deg={tilt}"])
    with Scanner(setup=setup) as scanner, pytest.raises(PlanningError, match=r"part comes within 1\.8 mm of clamp"):
        scanner.plan(block(0.05, 0.04, 0.02))
    with pytest.raises(DescriptionError, match=r"obstacle\[1\]\.moves_with = 'turn': expected world, tilt, table"):
        load_setup(assets_dir() / "cells/tilt_turn.toml", settings=[clamp.replace('"tilt"', '"turn"')])


def test_planned_motion_of_a_live_cell_turns_the_table_by_its_own_angle() -> None:
    """A tilt that starts a turn away from 0 does not count as the angle of the table."""
    settings = ["cell.axis[1].max_deg=400", "cell.axis[1].start_deg=360"]
    setup = load_setup(assets_dir() / "cells/tilt_turn.toml", settings=settings)
    part = load_part(assets_dir() / "parts/sphere_on_foot.stl")
    with Scanner(setup=setup) as scanner, scanner.session(part) as session:
        live = LiveCell(session)
        goal = np.append(session.home + 0.05, 0.2)
        moved = LivePlan(live, session).go_to(goal, "a pose near home")
        live.run(moved.done, realtime=False)
        moved.result()
        assert session.commanded == pytest.approx([*goal, 2 * np.pi], abs=1e-9)
