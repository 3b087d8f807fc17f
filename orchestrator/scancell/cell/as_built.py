"""Perturbations by name: ``dh[3].theta_deg=0.05`` is the FMU parameter ``as_built.dh[3].theta`` in SI."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from scancell.config.description import split_unit
from scancell.config.loading import parse_assignment, sensor_words
from scancell.errors import DescriptionError

_SUFFIXES_OF_UNIT = {"m": ("_mm", "_um"), "rad": ("_deg", "_mrad"), "s": ("_ms",), "Hz": ("_hz",)}
_PREFIX = "as_built."


def parse_as_built(words: Sequence[str], units: Mapping[str, str | None]) -> dict[str, float]:
    """FMU parameters (SI) from ``key=value`` words. Words that begin with ``sensor.`` are none of the FMU's.

    Parameters
    ----------
    units
        Unit of every ``as_built.*`` parameter of the FMU, from its model description.

    Raises
    ------
    DescriptionError
        If a key is unknown, wears the wrong unit, or its value is not a finite number.
    """
    return dict(_parse(word, units) for word in words if word not in sensor_words(words))


def _parse(word: str, units: Mapping[str, str | None]) -> tuple[str, float]:
    key, value = parse_assignment(word)
    name, scale = split_unit(key.removeprefix(_PREFIX))
    variable = _PREFIX + name
    if variable not in units:
        known = ", ".join(sorted(expected_keys(units)))
        raise DescriptionError(
            f"unknown perturbation '{key}'; known: {known}, and keys of the sensor: sensor.*",
            key="as_built",
            value=word,
        )
    suffixes = _SUFFIXES_OF_UNIT.get(units[variable] or "", ("",))
    if not any(suffix and key.endswith(suffix) for suffix in suffixes) and suffixes != ("",):
        raise DescriptionError(
            key="as_built", value=word, expected=f"a unit in the key: {' or '.join(name + s for s in suffixes)}"
        )
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise DescriptionError(key="as_built", value=word, expected=f"a finite number, got {value!r}")
    return variable, float(value) * scale


def expected_keys(units: Mapping[str, str | None]) -> list[str]:
    """Keys of all perturbations of the FMU, with units."""
    return [
        variable.removeprefix(_PREFIX) + _SUFFIXES_OF_UNIT.get(unit or "", ("",))[0]
        for variable, unit in units.items()
        if variable.startswith(_PREFIX)
    ]
