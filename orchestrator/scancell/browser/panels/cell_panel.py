"""Operation, monitor speed, gripper and conveyors; and perturbations of the true sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

from scancell.browser.panels.handles import Debounce, Follower
from scancell.browser.panels.operator_commands import OperatorCommands, can_move
from scancell.cell.driver import Operation
from scancell.config.choices import Engine
from scancell.config.sensor import SensorDescription
from scancell.live.camera import CameraFeed
from scancell.live.commands import CloseGripper, OpenGripper, RunConveyor, SetMonitorSpeed, SetOperation
from scancell.live.state import LiveState

_OPERATIONS = {"automatic": Operation.AUTOMATIC, "manual": Operation.MANUAL}
_MOST_WIDTH_MM, _MOST_FORCE, _MOST_SPEED_MM = 200.0, 200.0, 500.0


class CellPanel:
    """Inputs of the controller and of the devices."""

    def __init__(self, gui: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator = operator
        self._operation = Follower(gui.add_dropdown("operation", tuple(_OPERATIONS)))
        self._monitor = Follower(gui.add_slider("monitor speed, %", 0, 100, 1, 100))
        operator.connect(
            self._operation.handle, lambda: operator.submit(SetOperation(_OPERATIONS[self._operation.value])), can_move
        )
        operator.connect(self._monitor.handle, lambda: operator.submit(SetMonitorSpeed(self._monitor.value / 100)))
        if state.gripper_width is not None:
            self._add_gripper(gui, state.gripper_width)
        for number, (speed, _) in enumerate(state.conveyors, start=1):
            slider = gui.add_slider(
                f"conveyor {number}, mm/s", -_MOST_SPEED_MM, _MOST_SPEED_MM, 1.0, round(1e3 * speed)
            )
            operator.connect(slider, partial(self._run_conveyor, number, slider), can_move)
        self.show(state)

    def show(self, state: LiveState) -> None:
        """Show the operation and the monitor speed that were chosen."""
        name = next(name for name, value in _OPERATIONS.items() if value is state.operation)
        self._operation.show(name)
        self._monitor.show(round(100 * state.monitor_speed))

    def _add_gripper(self, gui: Any, width: float) -> None:
        operator = self._operator
        field = gui.add_number("gripper width, mm", round(1e3 * width, 1), min=0.0, max=_MOST_WIDTH_MM, step=1.0)
        force = gui.add_number("gripper force, N", 20.0, min=0.0, max=_MOST_FORCE, step=1.0)
        operator.add_inputs([field, force])
        opened, closed = gui.add_button("Open the gripper"), gui.add_button("Close the gripper")
        operator.connect(opened, lambda: operator.submit(OpenGripper(1e-3 * field.value)), can_move)
        operator.connect(closed, lambda: operator.submit(CloseGripper(force.value)), can_move)

    def _run_conveyor(self, conveyor: int, slider: Any) -> None:
        self._operator.submit(RunConveyor(conveyor, 1e-3 * slider.value))


@dataclass(frozen=True)
class Perturbation:
    """A value of the true sensor from `low` to `high`, with its `nominal` value."""

    label: str
    key: str
    nominal: float
    low: float
    high: float
    step: float


def perturbations(sensor: SensorDescription) -> list[Perturbation]:
    """Perturbations that the panel offers."""
    laser, detector = sensor.laser, sensor.detector
    found = [
        _around("laser offset x, mm", "sensor.laser.offset_x_mm", laser.offset_x_mm, 1.0, 0.01),
        _around("laser turn y, deg", "sensor.laser.turn_y_deg", laser.turn_y_deg, 1.0, 0.01),
        _around("laser turn z, deg", "sensor.laser.turn_z_deg", laser.turn_z_deg, 2.0, 0.01),
    ]
    for number, camera in enumerate(sensor.camera):
        key = f"sensor.camera[{number}]"
        found += [
            _around(f"{camera.name}: tilt, deg", f"{key}.tilt_deg", camera.tilt_deg, 0.5, 0.01),
            _around(f"{camera.name}: roll, deg", f"{key}.roll_deg", camera.roll_deg, 2.0, 0.01),
            _around(f"{camera.name}: offset y, mm", f"{key}.offset_y_mm", camera.offset_y_mm, 1.0, 0.01),
        ]
    noise, light = detector.read_noise_e, sensor.ambient.irradiance_w_m2
    return [
        *found,
        Perturbation("read noise, e-", "sensor.detector.read_noise_e", noise, 0.0, max(200.0, 2 * noise), 1.0),
        Perturbation("exposure, ms", "sensor.detector.exposure_ms", detector.exposure_ms, 0.01, 10.0, 0.01),
        Perturbation("ambient light, W/m²", "sensor.ambient.irradiance_w_m2", light, 0.0, max(20.0, 2 * light), 0.1),
    ]


def _around(label: str, key: str, nominal: float, reach: float, step: float) -> Perturbation:
    return Perturbation(label, key, nominal, round(nominal - reach, 3), round(nominal + reach, 3), step)


class SensorPanel:
    """Sliders for the true sensor; values that are not nominal perturb it."""

    def __init__(self, gui: Any, operator: OperatorCommands, feed: CameraFeed, sensor: SensorDescription) -> None:
        self._operator, self._feed, self._debounce = operator, feed, Debounce(delay=0.1)
        in_force = dict(word.split("=", 1) for word in feed.as_built)
        engine = gui.add_dropdown("engine", get_args(Engine), initial_value=feed.engine)
        operator.connect(engine, lambda: setattr(feed, "engine", engine.value))
        self._sliders = []
        for one in perturbations(sensor):
            value = float(in_force.pop(one.key, one.nominal))
            slider = gui.add_slider(one.label, one.low, one.high, one.step, min(max(value, one.low), one.high))
            self._sliders.append((one, operator.connect(slider, self._debounce.change)))
        others = " ".join(f"{key}={value}" for key, value in in_force.items())
        field = gui.add_text("others", others, hint="KEY=VALUE KEY=VALUE, as for --as-built")
        self._others = operator.connect(field, self._debounce.change)
        operator.connect(gui.add_button("All nominal"), self._restore)

    def show(self, state: LiveState) -> None:
        """Perturb the sensor when the sliders are released."""
        if self._debounce.take():
            self._operator.as_operator(lambda: self._feed.perturb(self._words()))

    def _words(self) -> list[str]:
        changed = [(one.key, slider.value) for one, slider in self._sliders if abs(slider.value - one.nominal) > 1e-9]
        return [*(f"{key}={value:g}" for key, value in changed), *self._others.value.split()]

    def _restore(self) -> None:
        for one, slider in self._sliders:
            slider.value = one.nominal
        self._others.value = ""
        self._feed.perturb(())
