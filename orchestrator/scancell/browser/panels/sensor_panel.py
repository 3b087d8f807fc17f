"""Perturbations of the true sensor, with their immediate effect on images and profile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

from scancell.browser.panels.debounce import Debounce
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.config.choices import Engine
from scancell.config.sensor import SensorDescription
from scancell.live.camera import CameraFeed
from scancell.live.state import LiveState


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
        self._engine = gui.add_dropdown("engine", get_args(Engine), initial_value=feed.engine)
        self._sliders = []
        for one in perturbations(sensor):
            value = float(in_force.pop(one.key, one.nominal))
            slider = gui.add_slider(one.label, one.low, one.high, one.step, min(max(value, one.low), one.high))
            slider.on_update(operator.callback(self._debounce.change))
            self._sliders.append((one, slider))
        others = " ".join(f"{key}={value}" for key, value in in_force.items())
        self._others = gui.add_text("others", others, hint="KEY=VALUE KEY=VALUE, as for --as-built")
        self._others.on_update(operator.callback(self._debounce.change))
        nominal = gui.add_button("All nominal")
        self._engine.on_update(operator.operator_callback(self._change_engine))
        nominal.on_click(operator.operator_callback(self._restore))
        operator.add_inputs([self._engine, *(slider for _, slider in self._sliders), self._others, nominal])

    def show(self, state: LiveState) -> None:
        """Perturb the sensor when the sliders are released."""
        if self._debounce.take():
            self._operator.as_operator(lambda: self._feed.perturb(self._words()))

    def _words(self) -> list[str]:
        changed = [(one.key, slider.value) for one, slider in self._sliders if abs(slider.value - one.nominal) > 1e-9]
        return [*(f"{key}={value:g}" for key, value in changed), *self._others.value.split()]

    def _change_engine(self) -> None:
        self._feed.engine = self._engine.value

    def _restore(self) -> None:
        for one, slider in self._sliders:
            slider.value = one.nominal
        self._others.value = ""
        self._feed.perturb(())
