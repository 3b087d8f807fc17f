"""Which directions of a sensor's parameters the measurements determine, and what is missing for the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.sensor.equations import Block
from scancell.calibration.sensor.parameters import RADIUS_OFFSET, SensorParameters
from scancell.calibration.sensor.reduction import reduced
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError

Array = NDArray[np.float64]

# Measurements that determine a direction no better than the tolerances of the data sheet do not determine it.
_LIMIT = 1.0
_NAMED = 0.3  # share of the largest component from which a parameter is named
_DEPTH_SHARE = 0.4  # of the measuring range
_ONE_DIRECTION = 0.05  # standard deviation of normals across their mean


def require_observable(sensor: SensorDescription, parameters: SensorParameters, blocks: Sequence[Block]) -> Array:
    """Standard deviations (k,) along the principal directions of the parameters, in tolerances, descending.

    Raises `CalibrationError` if one of them exceeds 1; the message names the direction and what is missing.
    """
    system = reduced(blocks)
    _, singular, directions = np.linalg.svd(
        system.by_parameter, full_matrices=len(system.residual) < len(parameters.names)
    )
    singular = np.concatenate([singular, np.zeros(len(parameters.names) - len(singular))])
    with np.errstate(divide="ignore"):
        deviations = 1.0 / np.abs(singular)  # LAPACK gives -0.0, too
    weak = deviations > _LIMIT
    if weak.any():
        lines = [_text(parameters, *pair) for pair in zip(directions[weak], deviations[weak], strict=True)]
        missing = "; ".join(_missing(sensor, parameters, blocks, directions[weak]))
        raise CalibrationError(
            "the measurements do not determine all free parameters of the sensor. Undetermined:\n  "
            + "\n  ".join(lines)
            + f"\nMissing: {missing}"
        )
    return np.asarray(deviations[::-1])


def _text(parameters: SensorParameters, direction: Array, deviation: float) -> str:
    """The direction by its main components, in units of the keys, relative to the first."""
    share = np.abs(direction)
    order = [k for k in np.argsort(-share) if share[k] >= _NAMED * share.max()]
    amounts = direction * parameters.scales / (direction * parameters.scales)[order[0]]
    terms = " ".join(f"{amounts[k]:+.3g} {parameters.names[k].removeprefix('sensor.')}" for k in order)
    spread = min(deviation * float(share[order[0]] * parameters.scales[order[0]]), 1e9)
    return f"{terms.removeprefix('+')} (standard deviation of the first: {spread:.2g})"


def _missing(
    sensor: SensorDescription, parameters: SensorParameters, blocks: Sequence[Block], weak: Array
) -> list[str]:
    """What would determine the weak directions (w, k)."""
    by_parameter = np.concatenate([block.by_parameter for block in blocks])
    direct = np.linalg.norm(by_parameter @ weak.T, axis=0)
    found = []
    if RADIUS_OFFSET in parameters.names and not by_parameter[:, parameters.names.index(RADIUS_OFFSET)].any():
        found.append("a ball: no target has a radius to find")
    if (direct > 1.0 / _LIMIT).any():
        found.append(
            "the targets' poses in the sensor frame, or fewer free parameters: unknown poses of the targets take up"
            " these directions"
        )
    point = np.concatenate([block.point for block in blocks])
    own = np.isfinite(point).all(1)
    if not own.any():
        return [*found, "the laser's stripe on targets: the measurements hold none"]
    z_mm = 1e3 * np.quantile(point[own, 2], [0.02, 0.98])
    limits = sensor.range
    if z_mm[1] - z_mm[0] < _DEPTH_SHARE * (limits.far_mm - limits.near_mm):
        found.append(
            f"heights: all points lie at z = {z_mm[0]:.4g} .. {z_mm[1]:.4g} mm of the range"
            f" {limits.near_mm:g} .. {limits.far_mm:g} mm"
        )
    normal = np.concatenate([block.normal for block in blocks])[own]
    if (normal - normal.mean(0)).std(0).max() < _ONE_DIRECTION:
        found.append("directions: all surfaces face the same way; tilt the target about X and Y, or use a ball")
    if not found:
        found.append(
            "other places and directions of the target, or a checkered target, which separates the cameras'"
            " direction, principal point and field of view"
        )
    return found
