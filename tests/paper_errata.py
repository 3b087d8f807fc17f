"""Sizes of the errors of printed equations of the paper, for the shipped cell and sensor: docs/paper.md states them."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from guard_motions import NOISE, cell_of, random_motion
from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.scan import QualityDescription
from scancell.config.sensor import sensor_json
from scancell.geometry.pose import log_rotation
from scancell.guard.endpoints import Identifier, _Window
from scancell.guard.parts import Tool
from scancell.guard.stopping import Path
from scancell.planning.path_map import configuration_map

Array = NDArray[np.float64]

# Where Eq. 8 leaves 0 and reaches 1 with the shipped scan, and a distance just below.
LIMITS_MM = (load_setup().scan.clearance_mm, QualityDescription().full_clearance_mm, 49.0)


def sensor_of(form: str) -> sensor_rt.Sensor:
    """The shipped sensor with a value of ``extraction.triangulation``."""
    setup = load_setup(settings=[f'sensor.extraction.triangulation="{form}"'])
    return sensor_rt.Sensor(json.dumps(sensor_json(setup.sensor, seed=0)))


def equation_4() -> dict[str, float]:
    """Largest error of Y over the image as a ratio and in mm, error of Z in mm, and the stray f in px."""
    exact, printed = sensor_of("exact"), sensor_of("eq4_as_printed")
    camera = exact.cameras[0]
    columns, rows = np.linspace(-0.5, camera.width_px - 0.5, 40), np.linspace(-0.5, camera.height_px - 0.5, 41)
    pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    right = sensor_rt.triangulate_pixels(pixels, exact, 0, "exact")
    wrong = sensor_rt.triangulate_pixels(pixels, printed, 0, "eq4_as_printed")
    off = np.abs(wrong - right)
    return {
        "ratio": float((wrong[:, 1] / right[:, 1]).max() - 1),
        "y_mm": float(1e3 * off[:, 1].max()),
        "z_mm": float(1e3 * off[:, 2].max()),
        "focal_px": camera.focal_px,
    }


def equation_5() -> dict[str, float]:
    """Half-widths of the measuring range, mm, at its near and far end, corrected and printed, and the ratio less 1."""
    right, wrong = (1e3 * sensor_of(form).trapezoid(0) for form in ("exact", "eq5_as_printed"))
    assert np.array_equal(right[:, 1], wrong[:, 1])
    return {
        "near_mm": right[1, 0],
        "printed_near_mm": wrong[1, 0],
        "far_mm": right[2, 0],
        "printed_far_mm": wrong[2, 0],
        "ratio": wrong[1, 0] / right[1, 0] - 1,
    }


def equation_7(beyond_deg: float = 10.0) -> tuple[float, float]:
    """Product over all joints, printed and corrected: joints 1 and 5 beyond their limits, the others in mid-range."""
    arm = cell_of("six_axis")[0].arm
    lower, upper = arm.limits
    q = (lower + upper) / 2
    q[[0, 4]] = upper[[0, 4]] + np.radians(beyond_deg)
    printed = np.sin(np.pi * (q - lower) / (upper - lower))
    return float(printed.prod()), float(configuration_map.arm_metric(arm, q))


def equation_8() -> tuple[float, float]:
    """Factor, printed and corrected, at the distance of `LIMITS_MM`."""
    low, high, distance = (1e-3 * length for length in LIMITS_MM)
    printed, corrected = (float(configuration_map.clearance(distance, low, high, printed=p)) for p in (True, False))
    return printed, corrected


def equation_10(motions: int = 1000) -> dict[str, float]:
    """Translations of the tool by hand at the encoders' noise and 32 ms: angles in degrees.

    `between`: median angle between the axes of two measurements of one motion; `turn`: median rotation that the noise
    feigns.
    """
    tool, rng = Tool(cell_of("six_axis")[0]), np.random.default_rng(31)
    between: list[float] = []
    turns: list[float] = []
    for _ in range(motions):
        motion = random_motion("six_axis", "translation", rng)
        axes = []
        for _ in range(2):
            rotation = tool.poses(np.array([state.axes[:-1] for state in motion.states(rng)]))[0][:, :3, :3]
            turn = log_rotation(rotation[0].T @ rotation[2])
            turns.append(float(np.linalg.norm(turn)))
            axes.append(turn / turns[-1])
        between.append(float(np.arccos(np.clip(axes[0] @ axes[1], -1, 1))))
    return {"between": float(np.degrees(np.median(between))), "turn": float(np.degrees(np.median(turns)))}


def lower_residual(motions: int = 500) -> tuple[dict[str, float], float]:
    """Share of motions by hand whose path has the lower residual of Eqs. 9 and 10, by kind of motion.

    Residuals are in units of the encoders' noise; a translation or rotation may be of either frame. The second value is
    the share of all motions whose path the chi-squared tests keep.
    """
    nominal = cell_of("six_axis")[0]
    tool, identifier, rng = Tool(nominal), Identifier(nominal, NOISE), np.random.default_rng(32)
    shares, kept = {}, 0
    for name in ("single joint", "joints", "translation", "rotation", "base", "tool"):
        right = 0
        for _ in range(motions):
            motion = random_motion("six_axis", name, rng)
            states = motion.states(rng)
            noise = np.full(len(states[0].axes), NOISE)
            window = _Window(tool, np.array([s.time for s in states]), np.array([s.axes for s in states]), noise)
            best = min(Path, key=window.straightness)
            both = name in ("translation", "rotation")
            right += best is not Path.JOINT if both else best is motion.path
            kept += motion.path in [hypothesis.path for hypothesis in identifier.identify(states).hypotheses]
        shares[name] = right / motions
    return shares, kept / (motions * len(shares))


def main() -> None:
    """Print all figures."""
    for function in (equation_4, equation_5, equation_7, equation_8, equation_10, lower_residual):
        print(function.__name__, function())


if __name__ == "__main__":
    main()
