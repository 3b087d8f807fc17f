"""FMI 3 variant with arrays: same values as the scalars, with FMPy."""

from __future__ import annotations

from ctypes import c_double, c_size_t, c_uint32
from pathlib import Path

import fmpy
import numpy as np
import pytest
from cell_fixture import START, Array, Build, CellFmu, cell_description, read_description
from fmpy.validation import validate_fmu

from scancell.cell.fmu_file import build_fmu
from scancell.cell.fmu_package import FmuOptions


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Unpacked FMUs with scalars and with arrays."""
    root = tmp_path_factory.mktemp("arrays")
    found = []
    for arrays in (False, True):
        file = root / f"arrays-{arrays}.fmu"
        build_fmu(cell_description(), file, 3, FmuOptions(arrays=arrays))
        assert validate_fmu(str(file)) == []
        found.append(Path(fmpy.extract(str(file), str(file.with_suffix("")))))
    return found[0], found[1]


def read(cell: CellFmu, name: str) -> Array:
    """Value of a variable of any type and size."""
    variable = cell.variables[name]
    if variable.type == "String":
        return np.array([cell.get_string(name)])
    getter = {"Float64": "getFloat64", "Int32": "getInt32", "Boolean": "getBoolean", "Enumeration": "getInt64"}[
        variable.type
    ]
    size = int(np.prod([int(d.start) for d in variable.dimensions]))
    return np.array(getattr(cell.slave, getter)([variable.valueReference], nValues=size), dtype=float)


def test_arrays_and_scalars_describe_same_variables(folders: tuple[Path, Path]) -> None:
    scalars, arrays = (read_description(folder) for folder in folders)
    assert scalars.guid != arrays.guid
    by_name = {v.name: v for v in scalars.modelVariables}
    covered: list[str] = []
    for variable in arrays.modelVariables:
        names = [variable.name]
        if variable.dimensions:
            (dimension,) = variable.dimensions
            names = [f"{variable.name}[{i}]" for i in range(1, int(dimension.start) + 1)]
            assert len(names) > 1
            assert variable.name not in by_name
        assert variable.valueReference == by_name[names[0]].valueReference
        for number, name in enumerate(names, start=1):
            scalar = by_name[name]
            for key in ("type", "causality", "variability", "initial", "min", "max"):
                assert getattr(variable, key) == getattr(scalar, key), (name, key)
            assert (variable.declaredType and variable.declaredType.name) == (
                scalar.declaredType and scalar.declaredType.name
            )
            assert scalar.description in variable.description
            if scalar.start is not None and variable.dimensions:
                assert variable.start.split()[number - 1] == scalar.start
        covered += names
    assert covered == list(by_name)
    shapes = {v.name: [d.start for d in v.dimensions] for v in arrays.modelVariables}
    assert [int(n) for n in shapes["measured.q"]] == [6]
    assert [int(n) for n in shapes["truth.part[1].orientation"]] == [4]
    assert shapes["as_built.dh[1].a"] == []


def test_initial_dependencies_refer_to_arrays(folders: tuple[Path, Path]) -> None:
    scalars, arrays = (read_description(folder) for folder in folders)

    def named(names: set[str]) -> set[str]:
        known = {v.name for v in arrays.modelVariables}
        return {name if name in known else name.rsplit("[", 1)[0] for name in names}

    merged: dict[str, set[str]] = {}
    for unknown in scalars.initialUnknowns:
        (name,) = named({unknown.variable.name})
        merged.setdefault(name, set()).update(named({d.name for d in unknown.dependencies}))
    assert merged == {u.variable.name: {d.name for d in u.dependencies} for u in arrays.initialUnknowns}


def test_arrays_read_same_values_as_scalars(folders: tuple[Path, Path], open_fmu: Build) -> None:
    plain, cell = (open_fmu(folder) for folder in folders)
    for k in range(30):
        q = START + 0.05 * np.sin(0.1 * k)
        plain.command(q, 0.02 * k)
        plain.trigger(1, 0.03)
        for name, value in {"command.mode": 1, "command.trigger.mode": 1, "command.segment": 1}.items():
            cell.set(name, value)
        cell.slave.setFloat64([cell.variables["command.q"].valueReference], list(q))
        cell.set("command.table", 0.02 * k)
        cell.set("command.trigger.period", 0.03)
        for instance in (plain, cell):
            instance.step(16_000)
    assert plain.get_int("trigger.index") > 10
    for name, variable in cell.variables.items():
        if variable.causality == "output":
            names = (
                [f"{name}[{i + 1}]" for i in range(int(variable.dimensions[0].start))]
                if variable.dimensions
                else [name]
            )
            np.testing.assert_array_equal(read(cell, name), np.concatenate([read(plain, n) for n in names]))
    # Several arrays and scalars in one call, in any order.
    names = ["truth.sensor.position", "truth.table", "measured.q"]
    together = cell.slave.getFloat64([cell.variables[n].valueReference for n in names], nValues=10)
    np.testing.assert_array_equal(together, np.concatenate([read(cell, n) for n in names]))


@pytest.mark.parametrize(("element", "room"), [(0, 5), (0, 7), (0, 1), (1, 1), (1, 6)])
def test_wrong_number_of_array_values_is_an_error(
    folders: tuple[Path, Path], open_fmu: Build, element: int, room: int
) -> None:
    """Nothing is written beyond the buffer."""
    cell = open_fmu(folders[1])
    reference = (c_uint32 * 1)(cell.variables["measured.q"].valueReference + element)
    values = (c_double * 8)(*[7.0] * 8)
    with pytest.raises(Exception, match="fmi3GetFloat64"):
        cell.slave.fmi3GetFloat64(cell.slave.component, reference, c_size_t(1), values, c_size_t(room))
    assert list(values) == [7.0] * 8
    cell.slave.reset()
    cell.initialize()
    cell.step(1000)


def test_states_are_shared_between_variants(folders: tuple[Path, Path], open_fmu: Build) -> None:
    plain, cell = (open_fmu(folder) for folder in folders)
    plain.command(table=1.0)
    plain.step(200_000)
    cell.restore(cell.deserialize(plain.serialize(plain.save())), plain.time_us)
    for instance in (plain, cell):
        instance.step(10_330)
    np.testing.assert_array_equal(read(cell, "truth.part[1].position"), plain.vector("truth.part[1].position", 3))
