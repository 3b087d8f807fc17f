"""Conversion to SI by the unit suffixes of keys.

A description keeps the values of its file, so that it can be written back unchanged.
`to_si` strips the unit from each key and scales its value: ``{"radius_mm": 120.0}`` becomes ``{"radius": 0.12}``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

_SCALE_OF_SUFFIX: dict[str, float] = {
    "_deg_s3": math.pi / 180.0,
    "_deg_s2": math.pi / 180.0,
    "_deg_s": math.pi / 180.0,
    "_deg": math.pi / 180.0,
    "_mrad": 1e-3,
    "_mm_s2": 1e-3,
    "_mm_s": 1e-3,
    "_n_mm": 1e3,
    "_mm": 1e-3,
    "_um": 1e-6,
    "_nm": 1e-9,
    "_mw": 1e-3,
    "_ms": 1e-3,
    "_m_s2": 1.0,
    "_w_m2": 1.0,
    "_kg_m3": 1.0,
    "_kg_m2": 1.0,
    "_kg": 1.0,
    "_n_m_s_rad": 1.0,
    "_n_m_rad": 1.0,
    "_n_m": 1.0,
    "_hz": 1.0,
    "_n": 1.0,
}


def split_unit(key: str) -> tuple[str, float]:
    """Name without its unit, and the factor from that unit to SI (1 for a key without a convertible unit).

    Units that the program uses unchanged (``_px``, ``_e``, ``_dn``, ``_us``) are part of the name.
    """
    for suffix, scale in _SCALE_OF_SUFFIX.items():
        if key.endswith(suffix):
            return key[: -len(suffix)], scale
    return key, 1.0


def to_si(value: Any) -> Any:
    """Nested plain data with SI values, and keys without their units."""
    if isinstance(value, Mapping):
        converted = {}
        for key, item in value.items():
            name, scale = split_unit(key)
            converted[name] = to_si(item) if scale == 1.0 else _scaled(item, scale)
        return converted
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [to_si(item) for item in value]
    return value


def si_value(description: object, key: str) -> float:
    """SI value of one key of a description; the key's suffix is its unit."""
    return float(getattr(description, key)) * split_unit(key)[1]


def _scaled(value: Any, scale: float) -> Any:
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return [_scaled(item, scale) for item in value]
    return float(value) * scale
