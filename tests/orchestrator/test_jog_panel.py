"""Jogs by the buttons of the page, without a browser: axis, direction, share and frame of what is submitted."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scancell.browser.panels.cell_panel import JogPanel
from scancell.cell.driver import JogFrame
from scancell.config.loading import load_setup
from scancell.live.state import Command
from scancell.nominal.cell import nominal_cell

SENSOR_AXES = ("tool along x", "tool along y", "tool along z", "tool about x", "tool about y", "tool about z")


class Page:
    """Inputs by name, and what is submitted."""

    def __init__(self, joints: int = 6) -> None:
        self.inputs: dict[str, SimpleNamespace] = {}
        self.held: dict[str, Callable[[], None]] = {}
        self.submitted: list[Command] = []
        gui: Any = SimpleNamespace(
            add_dropdown=lambda name, options: self._add(name, options[0], options),
            add_slider=lambda name, _least, _most, _step, value: self._add(name, value),
            add_button=lambda name, **_: SimpleNamespace(
                on_hold=lambda jog, callback_hz: self.held.update({name: jog})
            ),
            add_command=lambda *_, **__: SimpleNamespace(on_trigger=lambda _callback: None),
        )
        operator: Any = SimpleNamespace(
            nominal=nominal_cell(load_setup().cell, None),
            callback=lambda function: function,
            add_inputs=lambda *_: None,
            submit=self.submitted.append,
        )
        state: Any = SimpleNamespace(joints=np.zeros(joints))
        JogPanel(gui, operator, state)

    def _add(self, name: str, value: Any, options: Any = ()) -> SimpleNamespace:
        self.inputs[name] = SimpleNamespace(value=value, options=options)
        return self.inputs[name]

    def jog(self, axis: str, sign: str, percent: float) -> Command:
        """What a held button submits."""
        self.inputs["axis"].value, self.inputs["deflection, %"].value = axis, percent
        self.held[f"Hold to jog {sign}"]()
        return self.submitted[-1]


@pytest.mark.parametrize("percent", [1, 40, 100])
@pytest.mark.parametrize("sign", ["+", "-"])
def test_each_axis_is_jogged_alone_by_its_share(sign: str, percent: int) -> None:
    page, share = Page(), float(f"{sign}{percent / 100}")
    for number, axis in enumerate((*(f"joint {i}" for i in range(1, 7)), "table")):
        jog = page.jog(axis, sign, percent)
        assert jog.name == "jog_joints"
        np.testing.assert_allclose(jog.arguments["deflections"], share * np.eye(7)[number])
    for number, axis in enumerate(SENSOR_AXES):
        jog = page.jog(axis, sign, percent)
        assert jog.name == "jog_sensor"
        np.testing.assert_allclose(jog.arguments["deflections"], share * np.eye(6)[number])


@pytest.mark.parametrize(("name", "frame"), [("world", JogFrame.WORLD), ("tool", JogFrame.SENSOR), ("table", "table")])
def test_tool_is_jogged_along_the_chosen_axes(name: str, frame: JogFrame | str) -> None:
    page = Page()
    assert name in page.inputs["x, y, z of"].options
    page.inputs["x, y, z of"].value = name
    jog = page.jog("tool along z", "-", 50)
    assert jog.name == "jog_sensor"
    assert (jog.arguments["frame"], jog.arguments["tool"]) == (frame, "sensor")


def test_arm_of_few_joints_has_no_jogs_of_the_tool() -> None:
    assert Page(5).inputs["axis"].options == (*(f"joint {i}" for i in range(1, 6)), "table")
