"""Operation, monitor speed, gripper and conveyors."""

from __future__ import annotations

from functools import partial
from typing import Any

from scancell.browser.panels.conditions import can_move
from scancell.browser.panels.handles import Follower
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.cell.controller import Operation
from scancell.live.commands import CloseGripper, OpenGripper, RunConveyor, SetMonitorSpeed, SetOperation
from scancell.live.state import LiveState

_OPERATIONS = {"automatic": Operation.AUTOMATIC, "manual": Operation.MANUAL}
_MOST_WIDTH_MM, _MOST_FORCE, _MOST_SPEED_MM = 200.0, 200.0, 500.0


class CellPanel:
    """Inputs of the controller and of the devices."""

    def __init__(self, gui: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator = operator
        self._operation = gui.add_dropdown("operation", tuple(_OPERATIONS))
        self._shown_operation = Follower(self._operation)
        self._monitor = gui.add_slider("monitor speed, %", 0, 100, 1, 100)
        self._shown_monitor = Follower(self._monitor)
        self._operation.on_update(operator.callback(self._set_operation))
        self._monitor.on_update(operator.callback(lambda: operator.submit(SetMonitorSpeed(self._monitor.value / 100))))
        operator.add_inputs([self._operation], can_move)
        operator.add_inputs([self._monitor])
        if state.gripper_width is not None:
            self._add_gripper(gui, state.gripper_width)
        for number, (speed, _) in enumerate(state.conveyors, start=1):
            slider = gui.add_slider(
                f"conveyor {number}, mm/s", -_MOST_SPEED_MM, _MOST_SPEED_MM, 1.0, round(1e3 * speed)
            )
            slider.on_update(operator.callback(partial(self._run_conveyor, number, slider)))
            operator.add_inputs([slider], can_move)
        self.show(state)

    def show(self, state: LiveState) -> None:
        """Show the operation and the monitor speed that were chosen."""
        name = next(name for name, value in _OPERATIONS.items() if value is state.operation)
        self._shown_operation.show(name)
        self._shown_monitor.show(round(100 * state.monitor_speed))

    def _set_operation(self) -> None:
        self._operator.submit(SetOperation(_OPERATIONS[self._operation.value]))

    def _add_gripper(self, gui: Any, width: float) -> None:
        self._width = gui.add_number("gripper width, mm", round(1e3 * width, 1), min=0.0, max=_MOST_WIDTH_MM, step=1.0)
        self._force = gui.add_number("gripper force, N", 20.0, min=0.0, max=_MOST_FORCE, step=1.0)
        opened, closed = gui.add_button("Open the gripper"), gui.add_button("Close the gripper")
        opened.on_click(self._operator.callback(lambda: self._operator.submit(OpenGripper(1e-3 * self._width.value))))
        closed.on_click(self._operator.callback(lambda: self._operator.submit(CloseGripper(self._force.value))))
        self._operator.add_inputs([self._width, self._force])
        self._operator.add_inputs([opened, closed], can_move)

    def _run_conveyor(self, conveyor: int, slider: Any) -> None:
        self._operator.submit(RunConveyor(conveyor, 1e-3 * slider.value))
