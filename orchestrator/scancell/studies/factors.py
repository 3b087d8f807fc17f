"""Factors: from drawn numbers to the descriptions and deviations of one scan.

A factor's path is that of ``--set`` (``cell.``, ``sensor.``, ``scan.``: the nominal description, known to planning and
reconstruction) or begins with ``as_built.`` (only the true cell).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.cell.as_built import parse_as_built
from scancell.config.cell import CellDescription
from scancell.config.description import Description, validate
from scancell.config.loading import FILE_KEYS, Setup, as_built_sensor, load_setup, parse_assignment, split_path
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.config.variation import DiscreteDescription, VariationMode, VaryingScansDescription
from scancell.errors import DescriptionError
from scancell.studies.designs import design
from scancell.studies.distributions import Value, correlated_normal, extremes, middles, values_at

Array = NDArray[np.float64]
Units = Mapping[str, str | None]

_AS_BUILT = "as_built."
_TRUE_SENSOR = "as_built.sensor."
_SECTIONS: dict[str, type[Description]] = {
    "cell": CellDescription,
    "sensor": SensorDescription,
    "scan": ScanDescription,
}
# Keys of `VaryingScansDescription` that take effect only through the nominal setup.
SETUP_KEYS = (*_SECTIONS, "set", "ideal")


@dataclass(frozen=True)
class Inputs:
    """Inputs of one scan: nominal descriptions, and deviations of the true cell as ``key=value`` words."""

    setup: Setup
    as_built: tuple[str, ...]


def checked_sections(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Descriptions of plain data by section.

    Raises
    ------
    DescriptionError
        Naming section, key, value and what was expected.
    """
    return {name: validate(_SECTIONS[name], table, name) for name, table in raw.items()}


def nominal_setup(described: VaryingScansDescription, folder: Path, source: str) -> Setup:
    """The nominal descriptions that a description of many scans names, by paths relative to `folder`.

    Raises
    ------
    DescriptionError
        Naming `source`, file, key, value and what was expected.
    """
    names = {kind: getattr(described, kind) for kind in _SECTIONS}
    found = {kind: folder / name if name is not None else None for kind, name in names.items()}
    try:
        return load_setup(**found, settings=described.set, ideal=described.ideal)
    except DescriptionError as error:
        raise error.within(source) from None


class Factors:
    """Variation around the nominal descriptions; `source` names the description in messages."""

    def __init__(self, study: VaryingScansDescription, setup: Setup, source: str) -> None:
        self._study = study
        self._setup = setup
        self._source = source
        self._raw = {name: getattr(setup, name).model_dump(mode="json") for name in _SECTIONS}
        singles = [(factor.path, factor.mode) for factor in study.factor]
        blocks = [(path, block.mode) for block in study.block for path in block.paths]
        self.labels = study.labels
        self._paths: list[tuple[str, VariationMode]] = singles + blocks
        self._nominals = [self._nominal(path) for path, _ in self._paths]

    @property
    def files(self) -> list[str]:
        """Files that factors may put in place of those of the cell description."""
        return [
            str(value)
            for factor in self._study.factor
            if split_path(factor.path)[-1] in FILE_KEYS and isinstance(factor.distribution, DiscreteDescription)
            for value in factor.distribution.values
        ]

    def draw(self) -> list[tuple[Value, ...]]:
        """Values of all factors in every trial of the design."""
        study = self._study
        blocks = [block.covariance_matrix for block in study.block]
        listed = [middles(factor.distribution) for factor in study.factor] + [None] * sum(len(b) for b in blocks)
        cube = design(study.design, listed, study.seed)
        columns: list[list[Value]] = [values_at(factor, cube[:, j]) for j, factor in enumerate(study.factor)]
        start = len(columns)
        for block, covariance in zip(study.block, blocks, strict=True):
            mean = np.array(block.mean or np.zeros(len(covariance)))
            drawn = correlated_normal(cube[:, start : start + len(mean)], mean, covariance)
            columns.extend(drawn.T.tolist())
            start += len(mean)
        return list(zip(*columns, strict=True)) if columns else [()] * len(cube)

    def inputs(self, values: Sequence[Value]) -> Inputs:
        """Descriptions and deviations of a trial.

        Raises
        ------
        DescriptionError
            If a value is out of bounds.
        """
        raw, words = dict(self._raw), list(self._study.as_built)
        for (path, mode), nominal, value in zip(self._paths, self._nominals, values, strict=True):
            result = value if mode == "absolute" else _changed(nominal, mode, value)
            if path.startswith(_AS_BUILT):
                words.append(f"{path.removeprefix(_AS_BUILT)}={_toml(result)}")
            else:
                section, *keys = split_path(path)
                raw[str(section)] = _with(raw[str(section)], keys, result, path)
        return Inputs(self._checked(raw), tuple(words))

    def check(self, units: Units) -> None:
        """Refuse factors that cannot work; `units` are those of the FMU's ``as_built.*`` parameters.

        Raises
        ------
        DescriptionError
            Naming the file, the factor, the value and what was expected.
        """
        parse_as_built(self._study.as_built, units)
        as_built_sensor(self._setup.sensor, self._study.as_built)
        for j, ((path, mode), nominal) in enumerate(zip(self._paths, self._nominals, strict=True)):
            try:
                if mode != "absolute":
                    # Its message about an unknown key is better than one about the nominal value.
                    self._check_result(path, 0.0 if nominal is None else nominal, units)
                self._check_nominal(mode, nominal, j)
                for value in self._probes(j):
                    result = value if mode == "absolute" else _changed(nominal, mode, value)
                    self._check_result(path, result, units)
            except DescriptionError as error:
                raise error.within(f"{self._source}: factor {path}") from None

    def _check_nominal(self, mode: VariationMode, nominal: Any, j: int) -> None:
        if mode == "absolute":
            return
        if isinstance(nominal, bool) or not isinstance(nominal, int | float):
            raise DescriptionError(f'its nominal value {nominal!r} is not a number; use mode = "absolute"')
        if mode == "relative" and nominal == 0:
            raise DescriptionError('its nominal value is 0, so a relative change has no effect; use mode = "additive"')
        whole = j < len(self._study.factor) and isinstance(self._study.factor[j].distribution, DiscreteDescription)
        if isinstance(nominal, int) and not whole:
            raise DescriptionError(f"its nominal value {nominal} must stay a whole number; use a discrete distribution")

    def _probes(self, j: int) -> list[Value]:
        factors = self._study.factor
        return extremes(factors[j].distribution) if j < len(factors) else [0.0]

    def _check_result(self, path: str, result: Value, units: Units) -> None:
        """Check one factor at this value, all others at nominal."""
        if path.startswith(_AS_BUILT):
            word = f"{path.removeprefix(_AS_BUILT)}={_toml(result)}"
            as_built_sensor(self._setup.sensor, [word])
            parse_as_built([word], units)
        else:
            section, *keys = split_path(path)
            name = str(section)
            self._checked({**self._raw, name: _with(self._raw[name], keys, result, path)})

    def _nominal(self, path: str) -> Any:
        if path.startswith(_TRUE_SENSOR):
            true = as_built_sensor(self._setup.sensor, self._study.as_built).model_dump(mode="json")
            return _value_at(true, split_path(path.removeprefix(_TRUE_SENSOR)))
        if path.startswith(_AS_BUILT):
            given = dict(parse_assignment(word) for word in self._study.as_built)
            key = path.removeprefix(_AS_BUILT)
            return given.get(key, given.get(path, 0.0))
        section, *keys = split_path(path)
        if section not in _SECTIONS or not keys:
            raise DescriptionError(
                file=self._source,
                key=f"factor {path}",
                expected="a path that begins with cell., sensor., scan. or as_built.",
            )
        return _value_at(self._raw[str(section)], keys)

    def _checked(self, raw: Mapping[str, Any]) -> Setup:
        changed = {name: table for name, table in raw.items() if table is not self._raw[name]}
        return Setup(**{**vars(self._setup), **checked_sections(changed)})


def _changed(nominal: Any, mode: VariationMode, value: Any) -> Value:
    result: Value = nominal + value if mode == "additive" else nominal * (1 + value)
    return result


def _toml(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _value_at(node: Any, keys: Sequence[str | int]) -> Any:
    """The value at the path, or None where there is none; validation reports unknown keys."""
    for key in keys:
        there = key in node if isinstance(node, dict) else isinstance(node, list) and key in range(len(node))
        if not there:
            return None
        node = node[key]
    return node


def _with(section: dict[str, Any], keys: Sequence[str | int], value: Value, path: str) -> dict[str, Any]:
    """A copy of a section with one value changed; missing tables are added."""
    changed = copy.deepcopy(section)
    node: Any = changed
    for key in keys[:-1]:
        if isinstance(key, str) and isinstance(node, dict) and node.get(key) is None:
            node[key] = {}
        node = _step(node, key, path)
    _step(node, keys[-1], path, missing=True)
    node[keys[-1]] = value
    return changed


def _step(node: Any, key: str | int, path: str, missing: bool = False) -> Any:
    if isinstance(node, list) and isinstance(key, int):
        if key >= len(node):
            raise DescriptionError(f"index [{key + 1}] does not exist, there are {len(node)}", key=path)
        return node[key]
    if isinstance(node, dict) and isinstance(key, str):
        return None if missing else node[key]
    raise DescriptionError(f"'{key}' is not inside a table", key=path)
