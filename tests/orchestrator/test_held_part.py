"""A part on the flange before a sensor on a post: kinematics, plans, scans, deviations as built, and calibration."""

from __future__ import annotations

import numpy as np
import pytest
from cells import block, cell_file, export_mm
from fcl_collisions import colliding
from planned_motion import assert_axis_limits, setpoints

from scancell import (
    CalibrationError,
    DescriptionError,
    Guard,
    Plan,
    PlanningError,
    Scanner,
    assets_dir,
    load_part,
    load_setup,
    nominal_cell,
)
from scancell.cell.driver import example_sequence
from scancell.geometry import pose
from scancell.nominal.cell import estimated_cell, flange_from_tool, fmu_frame, tool_names
from scancell.planning.model import PlanningCell, SensorRange
from scancell.proximity.scene import arm_chain, moving_pairs
from scancell.scanning.world import make_sensor
from scancell.views.motion import scan_motion

CELL = assets_dir() / "cells/held_part.toml"
BLOCK = assets_dir() / "parts/step_block.stl"
FEW = ["scan.max_profiles=40"]

# The post on a lift, and the arm on a track.
AXES = """
[[axis]]
name = "lift"
kind = "prismatic"
pose = { x_mm = 580.0, y_mm = 20.0, z_mm = 380.0, rx_deg = 2.0 }
min_mm = -50.0
max_mm = 120.0
max_speed_mm_s = 100.0
max_acceleration_mm_s2 = 300.0

[[axis]]
name = "track"
kind = "prismatic"
along = "y"
min_mm = -100.0
max_mm = 100.0
max_speed_mm_s = 400.0
max_acceleration_mm_s2 = 900.0
"""
ON_LIFT = [
    'cell.tool.moves_with="lift"',
    "cell.tool.fixture=null",
    "cell.tool.pose={ x_mm = -10.0, rx_deg = 1.0, ry_deg = -90.0, rz_deg = 90.0 }",
    'cell.robot_moves_with="track"',
    'cell.part.moves_with="flange"',
    "cell.part.z_mm=30",
    "cell.part.rx_deg=20",
    "cell.table.pose={ y_mm = 500.0, z_mm = 100.0 }",
]


def lifted(tmp_path, *words: str):
    text = cell_file(tmp_path, AXES).read_text()
    (tmp_path / "lifted.toml").write_text(
        text.replace("[tool.fixture]\nplate_mm = 10.0\nreach_mm = 70.0\n", "[tool]\n")
    )
    return load_setup(tmp_path / "lifted.toml", settings=[*(w for w in ON_LIFT if "null" not in w), *words], ideal=True)


def planning_cell(setup, part) -> PlanningCell:
    sensor = make_sensor(setup.sensor, 0)
    return PlanningCell(nominal_cell(setup.cell, part), SensorRange.of(sensor), setup.cell.world.controller_cycle)


def test_true_poses_are_those_of_the_tree_with_deviations_of_sensor_and_grasp(tmp_path) -> None:
    """The trees of the FMU and of the orchestrator, at random positions of all axes."""
    setup = lifted(tmp_path)
    rng = np.random.default_rng(5)
    names = [f"{group}.{key}" for group in ("tool", "grasp") for key in ("x", "y", "z", "rx", "ry", "rz")]
    values = dict(zip(names, rng.uniform(-3e-3, 3e-3, len(names)), strict=True))
    as_built = {
        f"{name}_{'deg' if '.r' in name else 'mm'}": np.degrees(value) if ".r" in name else 1e3 * value
        for name, value in values.items()
    }
    part = load_part(BLOCK)
    with Scanner(setup=setup) as scanner, scanner.session(part, as_built=as_built) as session:
        true = estimated_cell(session.nominal, values)
        for _ in range(4):
            session.start_move_joints(session.home + rng.uniform(-0.2, 0.2, 6), float(rng.uniform(-3, 3)))
            session.wait(0.1)
            session.move_axis("lift", float(rng.uniform(-0.05, 0.1)))
            session.move_axis("track", float(rng.uniform(-0.1, 0.1)))
            axes = session.cell.get(session.cell.real_group(session.cell.axis_names("truth."))).copy()
            taken = session.snapshot(1e-4)
            for frame, expected in true.tree.place(axes, ["part", "sensor", "link[6]", "lift"]).items():
                assert taken.truth_at_middle(fmu_frame(frame))[0] == pytest.approx(expected, abs=1e-12), frame
        assert set(true.tree.axes_of("sensor")) == {"lift"}
        assert set(true.tree.axes_of("part")) == {"track", *(f"joint[{i}]" for i in range(1, 7))}


@pytest.mark.parametrize("held", [True, False])
def test_pose_of_the_flange_puts_the_sensor_where_it_is_wanted_in_the_part(tmp_path, held: bool) -> None:
    setup = lifted(tmp_path) if held else load_setup()
    cell, rng = nominal_cell(setup.cell, load_part(BLOCK)), np.random.default_rng(2)
    for frame in ("part", cell.support):
        axes = np.concatenate([cell.home + rng.uniform(-0.3, 0.3, 6), rng.uniform(-0.04, 0.04, len(cell.axes) - 6)])
        placed = cell.tree.place(axes, [frame, "sensor", cell.arm.flange])
        wanted = pose.inverse(placed[frame]) @ placed["sensor"]
        found = cell.world_from_flange(wanted, np.concatenate([np.zeros(6), axes[6:]]), frame)
        assert found == pytest.approx(placed[cell.arm.flange], abs=1e-12)


@pytest.mark.parametrize("part", ["artefacts/cone.toml", "parts/machined.stl"])
def test_part_on_the_flange_is_measured_without_error(part: str) -> None:
    setup = load_setup(CELL, settings=["scan.max_profiles=60"], ideal=True)
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(assets_dir() / part, engine="geometric")
    assert len(result.recording) == len(result.plan.axes)
    assert len(result.cloud) > 50_000
    assert result.deviation.rms < 0.1e-6
    assert np.abs(result.cloud.points_in_part).max() < 0.06
    # Exposures are where they were planned: the path of the sensor in the frame of the flange triggers them.
    assert np.abs(result.recording.measured.axes[:, :7] - result.plan.axes).max() < 2e-5
    assert "points on the flange" in result.summary()
    assert set(result.dropped.foreign) == {"chuck"}
    motion = scan_motion(result.nominal, result.recording, result.plan)
    for time in (0.0, 0.37 * motion.duration):
        frames = motion.frames(time)
        on_flange = pose.inverse(frames["link[6]"]) @ frames["part"]
        assert on_flange == pytest.approx(result.nominal.table_from_part, abs=1e-9)
    assert result.frame_from_part("flange") == pytest.approx(result.nominal.table_from_part)
    with pytest.raises(DescriptionError, match="frame = 'table': expected part, flange, base or world"):
        result.frame_from_part("table")


def test_images_of_a_part_on_the_flange_give_its_shape() -> None:
    setup = load_setup(CELL, settings=FEW, ideal=True)
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(BLOCK, engine="ray-traced")
    assert len(result.cloud) > 20_000
    assert result.deviation.rms < 2e-6


def test_part_between_the_fingers_is_scanned(tmp_path) -> None:
    grip = [
        "cell.gripper={ pose = { z_mm = 40.0 }, stroke_mm = 90.0, start_mm = 50.0, finger_length_mm = 45.0,"
        " finger_width_mm = 16.0, housing_mm = [90.0, 40.0, 40.0] }",
        "cell.part.z_mm=70",
        "cell.part.rz_deg=90",
        f'cell.obstacle=[{{ name = "post", mesh = "{assets_dir()}/sensors/sensor_post.stl",'
        " pose = { x_mm = 650.0, z_mm = 400.0 } }]",
    ]
    setup = load_setup(CELL, settings=[*FEW, *grip], ideal=True)
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(BLOCK, engine="geometric")
    # Points on a finger within 1.5 mm of where it touches the part count as the part's.
    distance = result.deviation.distance
    on_part = np.abs(distance) < 0.1e-6
    assert on_part.mean() > 0.85
    assert np.abs(distance).max() < 1.5e-3
    x, y, _ = result.cloud.points_in_part[~on_part].T
    assert np.abs(x).max() <= 8.01e-3
    assert np.abs(y).min() >= 24.99e-3
    assert {"finger1", "finger2"} <= set(result.dropped.foreign)


def test_plan_keeps_every_body_clear_of_the_held_part_by_true_poses() -> None:
    """python-fcl finds no contact at the true poses of every step of the driven plan, with a grasp off by 0.5 mm."""
    setup = load_setup(CELL, settings=FEW)
    part = load_part(assets_dir() / "parts/machined.stl")
    as_built = {"grasp.x_mm": 0.5, "grasp.rz_deg": 0.3, "tool.z_mm": -0.4}
    with Scanner(setup=setup) as scanner, scanner.session(part, as_built=as_built) as session:
        plan, nominal, poses = scanner.plan(part), session.nominal, []

        def take() -> None:
            taken = session.snapshot(1e-4)
            placed = {"world": np.eye(4)}
            for body in nominal.bodies:
                if body.moves_with not in placed:
                    placed[body.moves_with] = taken.truth_at_middle(fmu_frame(body.moves_with))[0]
            poses.append(np.stack([placed[body.moves_with] for body in nominal.bodies]))

        session.cell.on_step(take)
        session.run_program(plan.program, session.exposure)
    meshes = {body.name: body.mesh for body in nominal.bodies}
    pairs = moving_pairs(nominal)
    for other in ("sensor", "table", "link4", "base", "post"):
        assert frozenset(("part", other)) in set(map(frozenset, pairs))
    relevant = [pair for pair in pairs if {"part", "chuck", "sensor", "post"} & set(pair)]
    assert len(poses) > 500
    assert colliding(meshes, relevant, np.array(poses)) == set()
    cell = planning_cell(setup, part)
    assert_axis_limits(cell, plan)
    steps = np.diff(setpoints(plan)[:, -1])
    assert not steps.any()  # the table rests
    assert "part" in arm_chain(nominal)
    assert "sensor" not in arm_chain(nominal)


def test_obstacle_in_the_way_of_the_held_part_is_kept_clear_of(tmp_path) -> None:
    """A wall beside the part turns away views that hold without it."""
    wall = export_mm(block(0.3, 0.01, 0.5), tmp_path / "wall.stl")
    stands = f'{{ name = "wall", mesh = "{wall}", pose = {{ x_mm = 450.0, y_mm = -70.0, z_mm = 200.0 }} }}'
    kept = "".join(
        f'{{ name = "{name}", mesh = "{assets_dir()}/{mesh}", {place} }}, '
        for name, mesh, place in (
            ("post", "sensors/sensor_post.stl", "pose = { x_mm = 650.0, z_mm = 400.0 }"),
            ("chuck", "tables/chuck.stl", 'moves_with = "flange"'),
        )
    )
    setup = load_setup(CELL, settings=[*FEW, f"cell.obstacle=[{kept}{stands}]", "scan.max_lost_share=1"])
    with Scanner(setup=setup) as scanner:
        plan = scanner.plan(load_part(assets_dir() / "parts/machined.stl"))
    assert any("wall" in warning for warning in plan.warnings)
    cell = planning_cell(setup, load_part(assets_dir() / "parts/machined.stl"))
    assert not [c for c in cell.clearance_violations(setpoints(plan)[::5], 4e-3) if "wall" in (c.body_a, c.body_b)]


@pytest.mark.parametrize(
    "words",
    [
        ['scan.mode="stop-and-look"', "scan.max_profiles=24"],
        ["scan.coverage.share=0.4", "scan.max_profiles=60"],
        [
            "scan.sweep.enabled=false",
            "scan.raster.enabled=false",
            'scan.path=[{ name = "over", waypoint = [{ x_mm = -30, y_mm = 3, z_mm = 20, elevation_deg = 70 },'
            " { x_mm = 30, y_mm = -2, z_mm = 20, elevation_deg = 70 }] }]",
            "scan.max_profiles=400",
        ],
        ["scan.pose=[{ z_mm = 110, rx_deg = 180 }, { x_mm = 20, z_mm = 112, rx_deg = 180, rz_deg = 30 }]"],
    ],
    ids=["stop-and-look", "coverage", "path", "poses"],
)
def test_every_kind_of_view_measures_the_held_part(words: list[str]) -> None:
    setup = load_setup(CELL, settings=words, ideal=True)
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(BLOCK, engine="geometric")
    assert len(result.recording) == len(result.plan.axes) > 1
    assert len(result.cloud) > 500
    assert result.deviation.rms < 0.1e-6


def test_poses_of_the_description_are_those_of_the_sensor_in_the_part() -> None:
    wanted = ["scan.pose=[{ z_mm = 110, rx_deg = 180 }, { x_mm = 20, z_mm = 112, rx_deg = 180, rz_deg = 30 }]"]
    setup = load_setup(CELL, settings=wanted, ideal=True)
    part = load_part(BLOCK)
    with Scanner(setup=setup) as scanner:
        plan = scanner.plan(part)
    found = nominal_cell(setup.cell, part).part_from_sensor(plan.axes)
    for at, (x, z, turn) in zip(found, ((0, 110, 0), (20, 112, 30)), strict=True):
        expected = pose.from_euler_xyz((1e-3 * x, 0, 1e-3 * z), np.radians([180, 0, turn]))
        assert at == pytest.approx(expected, abs=1e-9)


def test_arm_whose_last_joint_cannot_make_a_full_turn_passes_over_the_part() -> None:
    words = ["cell.robot.joint[6].min_deg=-170", "cell.robot.joint[6].max_deg=170", "scan.max_lost_share=1"]
    setup = load_setup(CELL, settings=[*FEW, *words], ideal=True)
    with Scanner(setup=setup) as scanner:
        plan = scanner.plan(load_part(BLOCK))
    assert any("no joint turns the part about the axis of the flange" in warning for warning in plan.warnings)
    names = [segment.name for segment in plan.program.segments if segment.trigger.kind != "off"]
    assert names
    assert all(name.startswith("pass") for name in names)


def test_saved_plan_of_a_held_part_is_scanned_and_checked_again(tmp_path) -> None:
    part = load_part(BLOCK)
    with Scanner(setup=load_setup(CELL, settings=FEW)) as scanner:
        plan = scanner.plan(part)
        again = scanner.scan(part, engine="geometric", plan=plan.save(tmp_path / "plan.json"))
        assert np.array_equal(Plan.load(tmp_path / "plan.json").axes, again.plan.axes)
    closer = load_setup(CELL, settings=[*FEW, "cell.tool.pose.x_mm=540"])
    with Scanner(setup=closer) as scanner, pytest.raises(PlanningError, match="part"):
        scanner.scan(part, engine="geometric", plan=tmp_path / "plan.json")


@pytest.mark.parametrize(
    ("what", "as_built"),
    [
        ("tool", {"tool.x_mm": 0.8, "tool.y_mm": -0.5, "tool.z_mm": 0.3, "tool.rx_deg": 0.2, "tool.rz_deg": -0.3}),
        ("grasp", {"grasp.x_mm": 0.5, "grasp.y_mm": 0.4, "grasp.z_mm": -0.3, "grasp.rx_deg": 0.4, "grasp.rz_deg": 1.0}),
    ],
)
def test_calibration_finds_sensor_and_part_and_mends_the_scan(what: str, as_built: dict[str, float]) -> None:
    with Scanner(setup=load_setup(CELL, settings=FEW, ideal=True)) as scanner:
        report = scanner.calibrate(what, as_built=as_built, seed=4)
        blind = scanner.scan(BLOCK, engine="geometric", as_built=as_built)
        seeing = scanner.scan(BLOCK, engine="geometric", as_built=as_built, estimated=report.estimated)
    assert len(report.rows) == 6
    for row in report.rows:
        assert row.true == pytest.approx(as_built.get(f"{row.name}_{row.unit}", 0.0))
        assert abs(row.error) < {"mm": 0.004, "deg": 0.003}[row.unit], row.name
    assert blind.deviation.rms > 50e-6
    assert seeing.deviation.rms < 5e-6
    place = {"tool": "sensor in the world", "grasp": "part on the flange"}[what]
    assert place in report.summary()
    assert "world_from_sensor_m" in report.figures
    with pytest.raises(DescriptionError, match="the sensor is not on the flange"):
        _ = report.flange_from_sensor
    moved = pose.inverse(blind.nominal.sensor.parent_from_joint) @ report.carrier_from_sensor
    assert np.linalg.norm(moved[:3, 3]) > 0.5e-3 if what == "tool" else moved == pytest.approx(np.eye(4))


def test_impossible_calibrations_are_refused() -> None:
    with Scanner(setup=load_setup(CELL)) as scanner:
        for what in ("table", "all"):
            with pytest.raises(
                CalibrationError, match=f"what = '{what}': the arm holds the part; expected tool, grasp"
            ):
                scanner.calibrate(what)
    with Scanner() as scanner, pytest.raises(CalibrationError, match="what = 'grasp': the part is not on the flange"):
        scanner.calibrate("grasp")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (['cell.tool.moves_with="flange"'], "the arm carries both part and sensor"),
        (['cell.part.moves_with="table"'], "the arm carries neither part nor sensor"),
    ],
)
def test_scan_is_refused_where_the_arm_moves_both_or_neither(words: list[str], message: str) -> None:
    with Scanner(setup=load_setup(CELL, settings=words)) as scanner, pytest.raises(DescriptionError, match=message):
        scanner.plan(block(0.04, 0.03, 0.02))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (['cell.tool.moves_with="rail"'], r"tool\.moves_with = 'rail': expected flange, world"),
        (['cell.tool.moves_with="table"'], r"tool\.moves_with = 'table': expected flange, world"),
        (["cell.tool.flange_from_sensor={}"], "give exactly one of flange_from_sensor, fixture and pose"),
        (['cell.part.fixture="free"'], 'moves_with = "flange": the part is rigid'),
        (['cell.tcp=[{ name = "flange", flange_from_tcp = {} }]'], "expected a name that no other tool has"),
        (['cell.obstacle[2].moves_with="link[6]"'], r"obstacle\[2\]\.moves_with = 'link\[6\]': expected world, table"),
    ],
)
def test_wrong_descriptions_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_setup(CELL, settings=words)


def test_set_ups_and_surveys_of_a_held_part_are_refused() -> None:
    with Scanner(setup=load_setup(CELL)) as scanner:
        with pytest.raises(DescriptionError, match=r"cell\.part\.moves_with = 'flange'"):
            scanner.place(block(0.04, 0.03, 0.02))
        with pytest.raises(DescriptionError, match=r"cell\.tool\.moves_with"):
            scanner.survey(block(0.04, 0.03, 0.02))


def test_pose_on_the_flange_needs_a_sensor_there() -> None:
    with pytest.raises(DescriptionError, match=r"fixture is a pose on the flange: expected pose with moves_with"):
        load_setup(settings=['cell.tool.moves_with="world"'])


def test_tools_of_the_arm_are_the_flange_and_described_ones() -> None:
    setup = load_setup(CELL, settings=['cell.tcp=[{ name = "tip", flange_from_tcp = { z_mm = 90.0 } }]'])
    cell = nominal_cell(setup.cell, load_part(BLOCK))
    assert tool_names(cell) == ("flange", "tip")
    assert np.array_equal(flange_from_tool(cell, "flange"), np.eye(4))
    with pytest.raises(DescriptionError, match="tool = 'sensor': expected 'flange', 'tip'"):
        flange_from_tool(cell, "sensor")
    with Scanner(setup=setup) as scanner, scanner.session(load_part(BLOCK)) as session:
        goal = pose.translation((0.0, 0.02, 0.01)) @ session.world_from_tool("flange")
        session.move_line(goal, "flange")
        assert session.world_from_tool("flange") == pytest.approx(goal, abs=1e-6)
        assert session.nominal.world_from_sensor(()) == pytest.approx(
            session.snapshot(1e-4).truth_at_middle("sensor")[0], abs=1e-12
        )


def test_example_of_the_sequencer_turns_the_held_part_before_the_sensor() -> None:
    setup = load_setup(CELL)
    steps = example_sequence(setup, nominal_cell(setup.cell, load_part(BLOCK)))
    turning = [step for step in steps if step.get("trigger.mode") == 1]
    assert turning
    cell = nominal_cell(setup.cell, load_part(BLOCK))
    q = [turning[0][f"q[{i}]"] for i in range(1, 7)]
    seen = cell.part_from_sensor(q)
    assert seen[:3, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)


def test_cell_with_axes_is_scanned_where_they_start(tmp_path) -> None:
    setup = lifted(tmp_path, *FEW, "cell.axis[1].start_mm=20", "cell.axis[2].start_mm=30", "cell.part.rx_deg=0")
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(assets_dir() / "parts/machined.stl", engine="geometric")
    assert result.deviation.rms < 0.1e-6
    held = result.nominal.with_axes_held()
    assert held.sensor.parent == "world"
    at = result.nominal.start
    assert held.world_from_sensor(at[:7]) == pytest.approx(result.nominal.world_from_sensor(at), abs=1e-12)


def test_guard_supervises_a_held_part() -> None:
    setup = load_setup(CELL)
    nominal = nominal_cell(setup.cell, load_part(BLOCK))
    guard, home = Guard(nominal, setup.cell.robot), nominal.start
    assert guard.check([home, home + 0.02]) is None
    # Views of the part from so near that it is inside the sensor's housing, at any turn about its axis.
    turns = pose.from_rotation(pose.rotation_about(2, np.radians(np.arange(0.0, 360.0, 15.0))))
    near = turns @ nominal.table_from_part @ pose.from_euler_xyz((0.0, 0.0, 5e-3), (np.pi, 0.0, 0.0))
    branches = nominal.arm.ik(nominal.world_from_flange(near, frame=nominal.support)).reshape(-1, len(nominal.home))
    (q, *_) = branches[np.isfinite(branches).all(1)]
    clash = guard.check([home, np.append(q, home[len(q) :])])
    assert clash is not None
    assert clash.distance < clash.clearance
    on_flange, standing = {"part", "chuck"}, {"sensor", "post"}
    there = guard.check([np.append(q, home[len(q) :])] * 2)
    assert there is not None
    assert len({there.body_a, there.body_b} & on_flange) == len({there.body_a, there.body_b} & standing) == 1
