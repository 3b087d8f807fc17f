"""Sliders of the joints with input of a user at any moment, without a browser."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scancell.browser.panels import cell_panel
from scancell.browser.panels.handles import Debounce
from scancell.live.state import Command

HOME = np.radians([10.0, 20.0])


class Handle:
    """An input as of viser: the value of the user arrives first, its callback later."""

    def __init__(self, value: float = 0.0) -> None:
        self.value, self.callbacks = value, []
        self.min = self.max = 0.0

    def on_update(self, callback: Callable[[], None]) -> None:
        self.callbacks.append(callback)

    on_click = on_update

    def call_back(self) -> None:
        for callback in self.callbacks:
            callback()


class Gui:
    """Makes handles, and keeps them."""

    def __init__(self) -> None:
        self.sliders: list[Handle] = []

    def add_slider(self, _name: str, low: float, high: float, _step: float, value: float) -> Handle:
        self.sliders.append(Handle(value))
        self.sliders[-1].min, self.sliders[-1].max = low, high
        return self.sliders[-1]

    def add_button(self, _name: str) -> Handle:
        return Handle()


class Operator:
    """Keeps what is submitted."""

    def __init__(self) -> None:
        self.submitted: list[Command] = []
        arm = SimpleNamespace(limits=np.radians([[-180.0] * 2, [180.0] * 2]))
        self.nominal = SimpleNamespace(arm=arm, home=HOME, further_axes=(), table_turns=True)
        self.submit = self.submitted.append

    def add_inputs(self, _handles: list[Any], _condition: Any) -> None:
        """All may be used."""

    def connect(self, handle: Handle, act: Callable[[], None], _condition: Any) -> Handle:
        handle.on_click(act)
        return handle

    def callback(self, act: Callable[[], None]) -> Callable[[], None]:
        return act


def state(joints: np.ndarray, table: float = 0.0) -> Any:
    return SimpleNamespace(axes=np.append(joints, table), table_angle=table, moving=False)


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Any:
    now = SimpleNamespace(time=0.0)
    monkeypatch.setattr(cell_panel, "Debounce", lambda: Debounce(lambda: now.time))
    gui, operator = Gui(), Operator()
    panel = cell_panel.JointPanel(gui, operator, state(HOME))  # type: ignore[arg-type]
    return SimpleNamespace(gui=gui, operator=operator, panel=panel, now=now)


def test_value_is_kept_if_the_display_updates_before_the_callback(rig: Any) -> None:
    slider = rig.gui.sliders[0]
    slider.value = 35.0
    rig.panel.show(state(HOME))
    slider.call_back()
    rig.now.time = 1.0
    rig.panel.show(state(HOME))
    np.testing.assert_allclose(np.degrees(rig.operator.submitted[0].arguments["joints"]), [35.0, 20.0])


def test_sliders_follow_the_robot_and_return_after_a_refused_motion(rig: Any) -> None:
    slider = rig.gui.sliders[0]
    rig.panel.show(state(np.radians([12.0, 20.0])))
    assert slider.value == 12.0
    slider.value = 35.0
    slider.call_back()
    rig.now.time = 1.0
    for _ in range(2):
        rig.panel.show(state(np.radians([12.0, 20.0])))
    assert len(rig.operator.submitted) == 1
    assert slider.value == 12.0


def test_table_is_shown_with_its_turns_which_stay_when_a_joint_is_moved(rig: Any) -> None:
    """Its slider goes a turn further to either side of the whole turn that it is next to."""
    turned, slider = state(HOME, np.radians(2295.0)), rig.gui.sliders[2]
    assert (slider.min, slider.max) == (-360.0, 360.0)
    rig.panel.show(turned)
    assert slider.value == pytest.approx(2295.0)
    assert (slider.min, slider.max) == (1800.0, 2520.0)
    for slider, value, expected in ((0, 35.0, None), (2, 2325.0, 2325.0)):
        rig.gui.sliders[slider].value = value
        rig.gui.sliders[slider].call_back()
        rig.now.time += 1.0
        rig.panel.show(turned)
        asked = rig.operator.submitted[-1].arguments["table_angle"]
        assert asked is None if expected is None else asked == pytest.approx(np.radians(expected))
        rig.panel.show(turned)


def test_slider_of_the_table_can_be_dragged_on_from_either_end(rig: Any) -> None:
    slider = rig.gui.sliders[2]
    for degrees, ends in (
        (359.9, (-360.0, 360.0)),
        (360.0, (0.0, 720.0)),
        (0.0, (-360.0, 360.0)),
        (-400.0, (-720.0, 0.0)),
    ):
        rig.panel.show(state(HOME, np.radians(degrees)))
        assert (slider.min, slider.max) == ends
        assert slider.value == pytest.approx(degrees)
