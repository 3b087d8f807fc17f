"""Variables of RTDE: their types, and their values in the simulated robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from scancell.geometry import pose

if TYPE_CHECKING:
    from scancell.arrays import Array
    from scancell.wire.ur.controller import UrController

_INT_REGISTERS = range(48)
_BITS = range(64, 128)

Reading = Callable[["UrController"], "Sequence[float] | Array | float"]

# Safety: modes, and bits of the status.
NORMAL, PROTECTIVE_STOP = 1, 3
_NORMAL_BIT, _PROTECTIVE_STOP_BIT, _STOPPED_BIT = 1 << 0, 1 << 2, 1 << 10
_RUNNING = 7  # robot_mode, and joint_mode 253
_JOINT_RUNNING = 253
_POWER_ON_BIT, _PROGRAM_RUNNING_BIT = 1 << 0, 1 << 1


def pose_vector(base_from_tcp: Array) -> Array:
    """Position (m) and rotation vector (rad) (6,) of a pose (4, 4)."""
    return np.append(base_from_tcp[:3, 3], pose.log_rotation(base_from_tcp[:3, :3]))


def pose_of(vector: Sequence[float] | Array) -> Array:
    """Pose (4, 4) of a position (m) and a rotation vector (rad) (6,)."""
    return pose.from_rotation(pose.exp_rotation(vector[3:]), vector[:3])


def _registers(direction: str) -> dict[str, str]:
    types = {f"{direction}_bit_registers{low}_to_{low + 31}": "UINT32" for low in (0, 32)}
    types |= {f"{direction}_bit_register_{i}": "BOOL" for i in _BITS}
    types |= {f"{direction}_int_register_{i}": "INT32" for i in _INT_REGISTERS}
    return types | {f"{direction}_double_register_{i}": "DOUBLE" for i in _INT_REGISTERS}


REGISTERS = _registers("input") | _registers("output")

# Inputs beside registers.
_WRITTEN = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "external_force_torque": "VECTOR6D",
}
INPUTS = _registers("input") | _WRITTEN

_OUTPUTS: dict[str, tuple[str, Reading]] = {
    "timestamp": ("DOUBLE", lambda c: c.robot.time),
    "target_q": ("VECTOR6D", lambda c: c.robot.targets),
    "target_qd": ("VECTOR6D", lambda c: c.robot.target_rates),
    "actual_q": ("VECTOR6D", lambda c: c.robot.joints),
    "actual_qd": ("VECTOR6D", lambda c: c.robot.joint_rates),
    "actual_TCP_pose": ("VECTOR6D", lambda c: pose_vector(c.robot.tcp_poses[0])),
    "actual_TCP_speed": ("VECTOR6D", lambda c: c.robot.measured_jacobian @ c.robot.joint_rates),
    "target_TCP_pose": ("VECTOR6D", lambda c: pose_vector(c.robot.tcp_poses[1])),
    "target_TCP_speed": ("VECTOR6D", lambda c: c.robot.measured_jacobian @ c.robot.target_rates),
    "tcp_offset": ("VECTOR6D", lambda c: pose_vector(c.robot.flange_from_tcp)),
    "actual_digital_input_bits": ("UINT64", lambda c: c.robot.inputs),
    "actual_digital_output_bits": ("UINT64", lambda c: c.robot.outputs),
    "robot_mode": ("INT32", lambda _: _RUNNING),
    "joint_mode": ("VECTOR6INT32", lambda _: [_JOINT_RUNNING] * 6),
    "safety_mode": ("INT32", lambda c: PROTECTIVE_STOP if c.robot.is_stopped else NORMAL),
    "safety_status": ("INT32", lambda c: PROTECTIVE_STOP if c.robot.is_stopped else NORMAL),
    "safety_status_bits": (
        "UINT32",
        lambda c: _PROTECTIVE_STOP_BIT | _STOPPED_BIT if c.robot.is_stopped else _NORMAL_BIT,
    ),
    "robot_status_bits": ("UINT32", lambda c: _POWER_ON_BIT | _PROGRAM_RUNNING_BIT * c.is_running),
    "runtime_state": ("UINT32", lambda c: c.runtime_state),
    "speed_scaling": ("DOUBLE", lambda c: c.robot.speed_in_force),
    "target_speed_fraction": ("DOUBLE", lambda c: c.speed_slider),
}

# What a controller has and the cell does not simulate: 0, so that clients that ask for everything start.
NOT_SIMULATED = {
    **dict.fromkeys(
        (
            *("target_qdd", "target_current", "target_moment", "actual_current", "actual_current_window"),
            *("joint_control_output", "actual_TCP_force", "joint_temperatures", "actual_joint_voltage"),
            *("ft_raw_wrench", "payload_inertia"),
        ),
        "VECTOR6D",
    ),
    **dict.fromkeys(("actual_tool_accelerometer", "payload_cog", "elbow_position", "elbow_velocity"), "VECTOR3D"),
    **dict.fromkeys(
        (
            *("actual_execution_time", "actual_momentum", "actual_main_voltage", "actual_robot_voltage"),
            *("actual_robot_current", "standard_analog_input0", "standard_analog_input1"),
            *("standard_analog_output0", "standard_analog_output1", "payload"),
        ),
        "DOUBLE",
    ),
}

OUTPUTS = {name: kind for name, (kind, _) in _OUTPUTS.items()} | NOT_SIMULATED | REGISTERS


def reading(controller: UrController, name: str) -> Sequence[float] | Array | float:
    """Value of an output variable in the present cycle."""
    if name in _OUTPUTS:
        return _OUTPUTS[name][1](controller)
    if name in NOT_SIMULATED:
        return {"DOUBLE": [0.0], "VECTOR3D": [0.0] * 3}.get(NOT_SIMULATED[name], [0.0] * 6)
    return controller.registers.get(name, 0)


def written(controller: UrController, values: dict[str, tuple[float, ...]]) -> None:
    """Take the values of input variables."""
    for name, value in values.items():
        if name in REGISTERS:
            controller.write_register(name, value[0])
    if int(values.get("speed_slider_mask", (0,))[0]) & 1 and "speed_slider_fraction" in values:
        controller.set_speed_slider(values["speed_slider_fraction"][0])
    for group, first in (("standard", 0), ("configurable", 8), ("tool", 16)):
        name = f"{group}_digital_output"
        if name in values and f"{name}_mask" in values:
            mask, bits = (int(values[key][0]) << first for key in (f"{name}_mask", name))
            controller.robot.outputs = controller.robot.outputs & ~mask | bits & mask
