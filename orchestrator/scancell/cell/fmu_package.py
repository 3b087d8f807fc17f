"""The files of an FMU by their path in the archive: binaries, model description, documentation, licences, terminals."""

from __future__ import annotations

import csv
import io
import json
import math
import subprocess
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from html import escape
from pathlib import Path
from string import Template
from typing import IO, Any, Literal
from xml.sax.saxutils import quoteattr

import fmpy
import numpy as np

from scancell.arguments import checked_fields
from scancell.cell.fmu_info import group_of, unit_of
from scancell.cell.instance import CellInstance
from scancell.config.loading import assets_dir
from scancell.errors import CellError

DURATION_S = 2.0
_TRIGGER_PERIOD_S = 0.05
_EXPOSURE_S = 0.002
_SWING = math.radians(4.0)  # amplitude of the joints
_TABLE_RATE = 0.8  # rad/s that the table reaches

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
INPUTS, OUTPUTS = "reference_inputs.csv", "reference_outputs.csv"
_DESCRIPTION = "Layered Standard providing information on related files included in an FMU."

_RUN_TIME = {
    "GLIBC": "glibc (libc.so.6, libm.so.6)",
    "GLIBCXX": "libstdc++.so.6",
    "CXXABI": "libstdc++.so.6",
    "GCC": "libgcc_s.so.1",
}

_TEMPLATE = Path(__file__).with_name("index.html")
# Descriptions of the groups of variables, by the first part of their names; other groups have none.
_GROUPS = {
    "command": "Inputs: commands to the cell. All of them are discrete.",
    "measured": "Measurements of encoders and drives, with their resolution, noise and latency.",
    "truth": "True values of the simulated world, which a real cell does not know.",
    "trigger": "The record of one exposure of the sensor: what was measured in its middle, and what was true.",
    "controller": "State of the robot controller.",
    "gripper": "The gripper.",
    "conveyor": "The conveyor belts.",
    "presence": "Presence sensors: whether something is in a sensitive volume.",
    "distance": "Distance sensors: the length of a light ray.",
    "collision": "Unintended contacts, and the smallest distance between bodies.",
    "as_built": "Parameters: how the cell as built differs from its description. All zero: as described.",
    "cell": "Parameters of the cell.",
}
_EVENTS = """<li>With event mode and early return, a step ends where the record of an exposure is ready; the clock
<code>trigger.clock</code>, where this FMU describes it, ticks. With an intermediate update the outputs can be read at
every cycle of the controller inside a step.</li>"""

# The icon fills a square of 20 mm.
_HALF_SIZE = "100"
_SCALE_TO_MM = "0.1"

FmiVersion = Literal[2, 3]
_LINUX = {2: "linux64", 3: "x86_64-linux"}
_WINDOWS = {2: "win64", 3: "x86_64-windows"}
# Zip entries carry a fixed date, so that the same cell gives the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Reference:
    """Inputs and outputs, a row per communication point: time, then the values of the names."""

    input_names: list[str]
    inputs: list[list[float | int]]
    output_names: list[str]
    outputs: list[list[float | int]]
    step_s: float

    def files(self) -> dict[str, str]:
        """Contents by path in the FMU."""
        return {
            f"{FOLDER}/fmi-ls-manifest.xml": _manifest(self.step_s),
            f"{FOLDER}/{INPUTS}": _csv(self.input_names, self.inputs),
            f"{FOLDER}/{OUTPUTS}": _csv(self.output_names, self.outputs),
        }


def _csv(names: Sequence[str], rows: Sequence[Sequence[float | int]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *names])
    writer.writerows([[repr(value) for value in row] for row in rows])
    return text.getvalue()


def _manifest(step_s: float) -> str:
    """Manifest of related files by the layered standard, for FMI 2 and FMI 3."""
    what = f"inputs from start values on, set at each communication point ({step_s:g} s apart) before the step from it"
    then = "outputs at each communication point, before its inputs are set"
    related = [
        ("testcase", INPUTS, f"Reference trajectory: {what}"),
        ("result", OUTPUTS, f"Reference trajectory: {then}"),
    ]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"',
        '    fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0"',
        f'    fmi-ls:fmi-ls-description="{_DESCRIPTION}">',
    ]
    lines += [
        f'  <Related type="text/csv" source="{source}" role="{role}" description={quoteattr(text)}/>'
        for role, source, text in related
    ]
    return "\n".join([*lines, "</fmiReferences>", ""])


def _swing(time: float) -> float:
    """Out and back once, from rest to rest: 0 to 1 to 0."""
    return 0.5 * (1 - math.cos(2 * math.pi * time / DURATION_S))


def _set_points(start: Sequence[float], time: float) -> list[float]:
    """Joints swing out of their start and back, with growing amplitude from base to wrist; the table gathers speed."""
    joints = len(start) - 1
    angles = [q + (i + 1) / joints * _SWING * _swing(time) for i, q in enumerate(start[:joints])]
    return [*angles, start[joints] + 0.5 * _TABLE_RATE / DURATION_S * time * time]


def record_reference(fmu: Path) -> Reference:
    """Step an FMU without array variables through a motion of all axes with timed exposures.

    Raises
    ------
    CellError
        If the FMU reports an error.
    """
    description = fmpy.read_model_description(str(fmu), validate=False)
    step_us = round(float(description.defaultExperiment.stepSize) * 1e6)
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    reals = [v.name for v in outputs if v.type in ("Real", "Float64")]
    integers = [v.name for v in outputs if v.type in ("Integer", "Int32", "Enumeration")]
    constant: dict[str, Any] = {"command.mode": 1, "command.trigger.mode": 1, "command.segment": 1}
    timing = {"command.trigger.period": _TRIGGER_PERIOD_S, "command.exposure": _EXPOSURE_S}
    with CellInstance(fmu) as cell:
        axes = cell.axis_names("command.")
        state, inputs = cell.real_group(reals), cell.real_group([*axes, *timing])
        encoders = cell.real_group(cell.axis_names("truth."))
        start = [float(value) for value in cell.get(encoders)]
        for name, value in constant.items():
            cell.set_integer(name, value)
        given: list[list[float | int]] = []
        seen: list[list[float | int]] = []
        while True:
            time = cell.time_us / 1e6
            values = [float(value) for value in cell.get(state)]
            seen.append([time, *values, *(cell.get_integer(name) for name in integers)])
            if time >= DURATION_S:
                break
            points = [*_set_points(start, time), *timing.values()]
            given.append([time, *constant.values(), *points])
            cell.set(inputs, np.array(points))
            cell.step_to(cell.time_us + step_us)
    return Reference([*constant, *axes, *timing], given, [*reals, *integers], seen, step_us / 1e6)


@dataclass(frozen=True)
class Component:
    """A bundled library, or code that is compiled in."""

    file: str
    source: str
    license: str
    text: str


@dataclass(frozen=True)
class Bundle:
    """Components, and the newest symbol version that they need of each run-time library."""

    components: tuple[Component, ...]
    needs: dict[str, str]
    windows: bool  # whether a binary for Windows is among the components

    @property
    def machine(self) -> str:
        """Kind of program that loads the FMU."""
        linux = f"64-bit x86 Linux with glibc {self.needs['GLIBC']} or later"
        return f"{linux}, or 64-bit x86 Windows" if self.windows else linux

    def dependencies(self) -> list[str]:
        """System requirements, one per line."""
        return [f"{_RUN_TIME[name]} with {name}_{version} or later" for name, version in sorted(self.needs.items())]


def read_bundle(runtime: Path, binary: str = "RobotCell") -> Bundle:
    """Read the lists that were written when the native part was built.

    Parameters
    ----------
    runtime
        Folder with the native part; `windows_dll` of it is optional.
    binary
        Whose components to list: the cell's with its libraries, or ``CellSequencer``.

    Raises
    ------
    CellError
        If a list is missing.
    """
    listing = _read(runtime / "bundle.json")
    components = [Component(**entry) for entry in listing["components"]]
    if binary != "RobotCell":
        components = [replace(part, file=f"{binary}.so") for part in components if part.file == "RobotCell.so"]
    dll = windows_dll(runtime, binary)
    if dll is not None:
        compiled_in = _read(dll.with_name("components.json"))[dll.name]
        components += [Component(file=dll.name, **entry) for entry in compiled_in]
    return Bundle(tuple(components), listing["needs"], dll is not None)


def windows_dll(runtime: Path, binary: str) -> Path | None:
    """The binary for Windows, which ``fmu/windows/build`` makes; None without it."""
    dll = runtime / "windows" / f"{binary}.dll"
    return dll if dll.is_file() else None


def _read(file: Path) -> dict[str, Any]:
    try:
        listing: dict[str, Any] = json.loads(file.read_text())
    except OSError as error:
        raise CellError(f"cannot be read: {error.strerror}; run `make setup`", file=file) from error
    return listing


def license_text(bundle: Bundle) -> str:
    """Entry point of the licence folder: which text applies to which file."""
    lines = [
        "Licences of everything in this FMU. Each line: file, where it comes from, licence, name of the text beside",
        "this file. The FMU itself is scancell; the other libraries are bundled unchanged but for names and paths.",
        "",
    ]
    lines += [f"{part.file}: {part.source}; {part.license}; {part.text}" for part in bundle.components]
    return "\n".join([*lines, ""])


def dependencies_text(bundle: Bundle) -> str:
    """External dependencies of the FMU."""
    lines = ["The binaries need a 64-bit x86 Linux that provides:", ""]
    lines += [f"- {line}" for line in bundle.dependencies()]
    if bundle.windows:
        lines += ["", "or a 64-bit x86 Windows, of which they need KERNEL32.dll and msvcrt.dll."]
    lines += ["", "Everything else lies beside the binary. The FMU opens no network connection."]
    return "\n".join([*lines, ""])


def index_page(description: Any, bundle: Bundle, reference: Reference) -> str:
    """The page; it needs no network.

    Parameters
    ----------
    description
        Model description as FMPy reads it.
    """
    groups: dict[str, list[Any]] = {}
    for variable in description.modelVariables:
        groups.setdefault(group_of(variable.name), []).append(variable)
    units = [
        (escape(unit.name), escape(display.name), f"{display.factor:.10g}")
        for unit in description.unitDefinitions
        for display in unit.displayUnits
    ]
    messages = [(_code(category.name), escape(category.description)) for category in description.logCategories]
    licenses = [
        (_code(part.file), escape(part.source), escape(part.license), f'<a href="licenses/{text}">{text}</a>')
        for part in bundle.components
        for text in [escape(part.text)]
    ]
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        name=escape(description.modelName),
        description=escape(description.description),
        facts=_facts(description, bundle),
        events="" if description.fmiVersion.startswith("2") else _EVENTS,
        dependencies="; ".join(map(escape, bundle.dependencies())),
        inputs=f"{FOLDER}/{INPUTS}",
        outputs=f"{FOLDER}/{OUTPUTS}",
        step_ms=f"{reference.step_s * 1e3:g}",
        rows=len(reference.outputs),
        columns=len(reference.output_names),
        links=" ".join(f'<a href="#{escape(name)}">{escape(name)}</a>' for name in groups),
        variables="\n".join(_group(name, variables, description) for name, variables in groups.items()),
        units=_table(["unit", "shown in", "factor"], units),
        messages=_table(["category", "meaning"], messages),
        licenses=_table(["file", "from", "licence", "text"], licenses),
    )


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """`rows` hold HTML."""
    cells = "".join(f"<th>{escape(text)}</th>" for text in heads)
    head = f"<thead><tr>{cells}</tr></thead>" if cells else ""
    lines = "\n".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<table class="{kind}">{head}<tbody>\n{lines}\n</tbody></table>'


def _code(text: str) -> str:
    return f"<code>{escape(text)}</code>"


def _facts(description: Any, bundle: Bundle) -> str:
    step = float(description.defaultExperiment.stepSize)
    rows = [
        ("FMI version", f"{description.fmiVersion}, Co-Simulation"),
        ("made by", description.generationTool),
        ("token", description.guid),
        ("licence", f"{description.license}; of bundled components: see the end"),
        ("machine", bundle.machine),
        ("variables", str(len(description.modelVariables))),
        ("communication step", f"any; {step * 1e3:g} ms by default, the cycle of the controller"),
    ]
    return _table([], ((escape(a), escape(b)) for a, b in rows))


def _group(name: str, variables: list[Any], description: Any) -> str:
    depends = {u.variable.name: [d.name for d in u.dependencies or ()] for u in description.initialUnknowns or ()}
    rows = []
    for variable in variables:
        unit, display = unit_of(variable)
        bounds = f"{variable.min} … {variable.max}" if variable.min is not None else ""
        size = "".join(f"[{dimension.start}]" for dimension in variable.dimensions)
        on = depends.get(variable.name, [])
        rows.append(
            [
                _code(variable.name),
                escape(f"{variable.type}{size}"),
                escape(f"{variable.variability or ''} {variable.causality}"),
                escape(unit) + (f" ({escape(display)})" if display else ""),
                escape(variable.start or ""),
                escape(bounds),
                escape(variable.description or "")
                + (f"<br><small>at first depends on {escape(_short(on))}</small>" if on else ""),
            ]
        )
    heads = ["name", "type", "kind", "unit (shown in)", "start", "range", "meaning"]
    title = f'<h3 id="{escape(name)}">{escape(name)}</h3><p>{escape(_GROUPS.get(name, ""))}</p>'
    return title + _table(heads, rows, "variables")


def _short(names: list[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


@dataclass
class _Terminal:
    """Members by their last name; a name may be that of a member and of a terminal inside."""

    members: dict[str, str] = field(default_factory=dict)
    inside: dict[str, _Terminal] = field(default_factory=dict)

    def add(self, path: list[str], name: str) -> None:
        if len(path) == 1:
            self.members[path[0]] = name
        else:
            self.inside.setdefault(path[0], _Terminal()).add(path[1:], name)

    def write(self, parent: ET.Element) -> None:
        """Members first, as the schema requires."""
        for member, name in self.members.items():
            attributes = {"variableName": name, "memberName": member, "variableKind": "signal"}
            ET.SubElement(parent, "TerminalMemberVariable", attributes)
        for name, terminal in self.inside.items():
            terminal.write(ET.SubElement(parent, "Terminal", {"name": name, "matchingRule": "plug"}))


def terminals_xml(variables: Iterable[Any]) -> bytes:
    """`terminalsAndIcons.xml` of FMI 3.

    The structured names give the tree: ``command.trigger.mode`` is the member ``mode`` of the terminal ``trigger``
    in the terminal ``command``.

    Parameters
    ----------
    variables
        As FMPy reads them; those that are neither inputs nor outputs are left out.
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    graphics = ET.SubElement(root, "GraphicalRepresentation")
    corners = {"x1": f"-{_HALF_SIZE}", "y1": f"-{_HALF_SIZE}", "x2": _HALF_SIZE, "y2": _HALF_SIZE}
    ET.SubElement(graphics, "CoordinateSystem", {**corners, "suggestedScalingFactorTo_mm": _SCALE_TO_MM})
    ET.SubElement(graphics, "Icon", corners)
    all_of_them = _Terminal()
    for variable in variables:
        if variable.causality in ("input", "output"):
            all_of_them.add(variable.name.split("."), variable.name)
    all_of_them.write(ET.SubElement(root, "Terminals"))
    ET.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n"


@checked_fields
@dataclass(frozen=True)
class FmuOptions:
    """Variants of an FMU.

    Attributes
    ----------
    clock
        Describe the clock of the exposures (FMI 3). Several importers fail on any clock (ecos frees memory twice,
        fmi-sim reads it as a Boolean), so it is off by default; event mode works without.
    arrays
        Merge indexed scalars into arrays (FMI 3): `measured.q` instead of `measured.q[1]` to `measured.q[6]`. Few
        importers read arrays.
    integers
        Describe modes, states and errors as integers instead of enumerations, which libcosim and ecos do not support.
    ahead
        Describe `controller.ahead`, the 64 next points of the path of a motion, which a guard reads: an array in FMI 3,
        64 scalars for each axis in FMI 2.
    records
        Describe arrays `trigger.records.*` of all records that became complete in a communication step (FMI 3).

    Examples
    --------
    >>> import zipfile
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> description = scancell.cell_json(setup.cell, nominal, seed=0)
    >>> scancell.build_fmu(description, "cell.fmu", version=3, options=scancell.FmuOptions(arrays=True))
    >>> b'name="measured.q"' in zipfile.ZipFile("cell.fmu").read("modelDescription.xml")
    True
    """

    clock: bool = False
    arrays: bool = False
    integers: bool = False
    ahead: bool = False
    records: bool = False


def fmu_contents(runtime: Path, cell: str, version: FmiVersion, options: FmuOptions) -> dict[str, bytes]:
    """All files of the FMU.

    Parameters
    ----------
    runtime
        Folder with the native library, its closure and the description printer.
    cell
        Description of the cell (JSON).

    Raises
    ------
    CellError
        If the native part refuses the description, or the cell cannot make its reference trajectory.
    """
    bundle = read_bundle(runtime)
    contents = {
        "modelDescription.xml": _describe(runtime, cell, version, options, bundle),
        "resources/cell.json": cell.encode(),
        "documentation/licenses/license.txt": license_text(bundle).encode(),
        "documentation/externalDependencies.txt": dependencies_text(bundle).encode(),
    }
    for library in sorted(runtime.glob("*.so*")):
        contents[f"binaries/{_LINUX[version]}/{library.name}"] = library.read_bytes()
    contents |= _optional_binary(runtime, "RobotCell", version) | dict(sorted(_licenses(runtime, bundle).items()))
    with tempfile.TemporaryDirectory(prefix="scancell-") as folder:
        fmu = Path(folder) / "RobotCell"
        write_unpacked(fmu, runtime, cell, version, FmuOptions())
        reference = record_reference(fmu)
    return {**contents, **_documents(contents["modelDescription.xml"], version, bundle, reference)}


def sequencer_contents(runtime: Path, cell: str, version: FmiVersion = 2) -> dict[str, bytes]:
    """All files of the FMU of the sequencer of a cell.

    Parameters
    ----------
    runtime
        Folder with the native library, its closure and the description printer.
    cell
        Description of the cell (JSON).

    Raises
    ------
    CellError
        If the native part refuses the description.
    """
    library = runtime / "sequencer" / "CellSequencer.so"
    bundle = read_bundle(runtime, "CellSequencer")
    return {
        "modelDescription.xml": _printed(
            [runtime / "sequencer" / "sequencer-describe", "-", "--fmi", str(version)], cell
        ),
        "resources/cell.json": cell.encode(),
        "documentation/licenses/license.txt": license_text(bundle).encode(),
        f"binaries/{_LINUX[version]}/{library.name}": library.read_bytes(),
        **_optional_binary(runtime, "CellSequencer", version),
        **_licenses(runtime, bundle),
    }


def sensor_contents(runtime: Path, sensor: str) -> dict[str, bytes]:
    """All files of the FMU (FMI 3) of a sensor.

    Parameters
    ----------
    runtime
        Folder with the native library, its closure and the description printer.
    sensor
        Description of the sensor and of what it sees (JSON).

    Raises
    ------
    CellError
        If the native part refuses the description.
    """
    bundle = read_bundle(runtime)
    return {
        "modelDescription.xml": _printed([runtime / "profile-sensor-describe", "-"], sensor),
        "resources/sensor.json": sensor.encode(),
        "documentation/licenses/license.txt": license_text(bundle).encode(),
        "documentation/externalDependencies.txt": dependencies_text(bundle).encode(),
        **{f"binaries/{_LINUX[3]}/{file.name}": file.read_bytes() for file in sorted(runtime.glob("*.so*"))},
        **dict(sorted(_licenses(runtime, bundle).items())),
    }


def _optional_binary(runtime: Path, binary: str, version: FmiVersion) -> dict[str, bytes]:
    """The binary for Windows, if it was built."""
    dll = windows_dll(runtime, binary)
    return {} if dll is None else {f"binaries/{_WINDOWS[version]}/{dll.name}": dll.read_bytes()}


def _licenses(runtime: Path, bundle: Bundle) -> dict[str, bytes]:
    """Licence texts of all components, by their path in the archive, in the order of the components."""
    texts = {}
    for part in bundle.components:
        folder = runtime / "windows" / "licenses" if part.file.endswith(".dll") else runtime / "licenses"
        texts[f"documentation/licenses/{part.text}"] = (folder / part.text).read_bytes()
    return texts


def write_unpacked(folder: Path, runtime: Path, cell: str, version: FmiVersion, options: FmuOptions) -> None:
    """Create a folder with the files of an FMU that an instance needs; libraries are linked.

    Raises
    ------
    CellError
        If the native part refuses the description.
    """
    description = _describe(runtime, cell, version, options, read_bundle(runtime))
    (folder / "resources").mkdir(parents=True)
    (folder / "binaries").mkdir()
    (folder / "modelDescription.xml").write_bytes(description)
    (folder / "resources" / "cell.json").write_text(cell)
    (folder / "binaries" / _LINUX[version]).symlink_to(runtime.resolve(), target_is_directory=True)


def _documents(model_description: bytes, version: FmiVersion, bundle: Bundle, reference: Reference) -> dict[str, bytes]:
    """Files for users and tools, which an instance does not need."""
    description = read_description(model_description)
    icon = assets_dir() / "fmu" / "icon.png"
    documents = {name: text.encode() for name, text in reference.files().items()}
    documents["documentation/index.html"] = index_page(description, bundle, reference).encode()
    if version == 2:
        return {**documents, "model.png": icon.read_bytes()}
    return {
        **documents,
        "terminalsAndIcons/terminalsAndIcons.xml": terminals_xml(description.modelVariables),
        "terminalsAndIcons/icon.png": icon.read_bytes(),
        "terminalsAndIcons/icon.svg": icon.with_suffix(".svg").read_bytes(),
    }


def read_description(model_description: bytes) -> Any:
    """Read it with FMPy, which requires an archive."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("modelDescription.xml", model_description)
    return fmpy.read_model_description(archive, validate=False)


def write_archive(path: Path | IO[bytes], contents: Mapping[str, bytes]) -> None:
    """Zip the contents; the same contents give the same bytes.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content)


def _describe(runtime: Path, cell: str, version: FmiVersion, options: FmuOptions, bundle: Bundle) -> bytes:
    """The model description, printed by the same variable table that the library answers from."""
    command: list[str | Path] = [runtime / "robotcell-describe", "-", "--fmi", str(version), "--needs", bundle.machine]
    command += [f"--{variant}" for variant, wanted in asdict(options).items() if wanted]
    return _printed(command, cell)


def _printed(command: list[str | Path], cell: str) -> bytes:
    """Output of a description printer for a description of a cell or a sensor."""
    result = subprocess.run(command, input=cell.encode(), capture_output=True, check=False)
    if result.returncode:
        raise CellError(f"{Path(command[0]).name} refuses the description: {result.stderr.decode().strip()}")
    return result.stdout
