"""The application, the decorator that registers its commands, and how an outcome or error is printed."""

from __future__ import annotations

import functools
import inspect
import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, get_args, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup
from typer.models import OptionInfo

import scancell
from scancell.cli.interrupts import EXIT_INTERRUPTED, interruptible
from scancell.config.choices import CloudFrame, Engine, LengthUnit
from scancell.errors import DescriptionError, ScancellError, named_by
from scancell.progress import NullProgress, Progress

if TYPE_CHECKING:
    from scancell.config.loading import Setup
    from scancell.output.run_folder import RunReport
    from scancell.progress import Progress
    from scancell.results import ScanResult


EXIT_ERROR = 1
# Arguments of Python functions that parameters of commands state in another way.
_RENAMED = {"is_size_known": "unknown_size"}

GROUPS = {
    "Scan": ("scan", "shot", "plan", "place", "layout", "survey", "render", "rerun", "extract", "reconstruct"),
    "Evaluate and calibrate": (
        "evaluate",
        "characteristics",
        "inspect",
        "capability",
        "compare",
        "mesh",
        "calibrate",
        "acceptance",
    ),
    "Many scans": ("study", "batch"),
    "Robot cell": ("workspace", "run", "program", "controller", "guard", "fmu", "ssp", "robot"),
    "Recorded runs": ("picture", "animate", "page", "export"),
    "About": ("schema", "version"),
}
_WITH_SUBCOMMANDS = {
    "calibrate": "Scan an artefact, find the deviations of the cell, and write a calibrated cell;"
    " or the same for a sensor.",
    "fmu": "Build and inspect FMUs of the robot cell.",
    "ssp": "Build packages of the robot cell and a controller of it.",
    "controller": "Let programs for a maker's controller move the simulated robot.",
    "guard": "Protect a robot from collisions.",
    "program": "Programs of robot controllers: export of planned scans.",
    "robot": "Make descriptions of arms.",
    "study": "Vary inputs over many scans: run, sensitivity analysis, report.",
}

KEY_VALUE, KEY_RANGE = "KEY=VALUE", "KEY=LOW:HIGH"  # metavars of options whose words set keys
JsonOption = Annotated[bool, typer.Option("--json", help="print one JSON object as the last line")]


class GroupedCommands(TyperGroup):
    """Help that lists commands by `GROUPS`, each with the first sentence of its own help."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the sections, all with one width of the names."""
        width = max(map(len, self.commands))
        for title, names in GROUPS.items():
            rows = [(name.ljust(width), _first_sentence(self.commands[name].help or "")) for name in names]
            with formatter.section(title):
                formatter.write_dl(rows)


class GroupOfCommands(TyperGroup):
    """Subcommands; ``calibrate sensor --from-images``, as version 0.2 had it, is ``calibrate board``."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The subcommand that the words name, and the words after it."""
        if args[0] == "sensor" and any(word.partition("=")[0] == "--from-images" for word in args):
            args = ["board", *args[1:]]
        return super().resolve_command(ctx, args)


class CommandOfSingleValues(TyperCommand):
    """A command that refuses an option of one value, or a key of several, that is given twice."""

    def make_parser(self, ctx: Any) -> Any:
        """The parser of the command line, which lists every use of an option."""
        parser: Any = super().make_parser(ctx)
        parse = parser.parse_args

        def parse_args(args: list[str]) -> Any:
            values, rest, used = parse(args=args)
            for option in {item.name: item for item in used if item.param_type_name == "option"}.values():
                if option.multiple:
                    given = [f"{option.opts[-1]} {str(word).partition('=')[0].strip()}" for word in values[option.name]]
                    given = given if option.metavar == KEY_VALUE else []
                elif option.is_flag and not option.secondary_opts:
                    continue
                else:
                    given = [option.opts[-1]] * used.count(option)
                for name, count in Counter(given).items():
                    if count > 1:
                        ctx.fail(f"{name} is given {count} times, but has one value")
            return values, rest, used

        parser.parse_args = parse_args
        return parser


def _first_sentence(text: str) -> str:
    return " ".join(text.split("\n\n", maxsplit=1)[0].split()).rstrip(".")


app = typer.Typer(
    cls=GroupedCommands,
    help="A robot cell that scans parts in 3D with a laser profile sensor, simulated end to end.",
    no_args_is_help=True,
    rich_markup_mode=None,  # importing rich takes longer than the rest of the help
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_apps = {"": app}
for _name, _help in _WITH_SUBCOMMANDS.items():
    _apps[_name] = typer.Typer(cls=GroupOfCommands, help=_help, no_args_is_help=True, rich_markup_mode=None)
    app.add_typer(_apps[_name], name=_name)


@dataclass
class Outcome:
    """Result of a command: `text` for the terminal, `code` the exit status, the rest for the JSON object."""

    text: list[str] = field(default_factory=list)
    figures: Mapping[str, Any] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    timings: Mapping[str, float] = field(default_factory=dict)
    code: int = 0

    @classmethod
    def of(cls, report: RunReport) -> Outcome:
        """The outcome that a report describes."""
        return cls(report.lines, report.figures, report.files, report.warnings, report.timings)


def command(
    name: str, options: type | None = None, around: Callable[[], AbstractContextManager[None]] = nullcontext
) -> Callable[[Callable[..., Outcome]], Callable[..., None]]:
    """Decorator: register a function as a command with the option ``--json``, and print the outcome that it returns.

    A parameter is annotated by its type and its help, or by what `typer` needs to know of it beyond that.

    Parameters
    ----------
    name
        Words of the command, such as ``fmu build``.
    options
        Dataclass whose fields become options of the command; the function receives them as `options`.
    around
        Context in which the function runs and its outcome is printed.
    """

    def decorate(function: Callable[..., Outcome]) -> Callable[..., None]:
        own = inspect.signature(function, eval_str=True).parameters
        shared: Mapping[str, inspect.Parameter] = {}
        if options is not None:
            hints = get_type_hints(options, include_extras=True)
            fields = inspect.signature(options).parameters
            shared = {key: item.replace(annotation=hints[key]) for key, item in fields.items()}

        @functools.wraps(function)
        def called(as_json: bool, **given: Any) -> None:
            if options is not None:
                given["options"] = options(**{key: given.pop(key) for key in shared if key in given}, as_json=as_json)
            if "as_json" in own:
                given["as_json"] = as_json
            with around():
                run(name, as_json, lambda: function(**given))

        listed = {key: item for key, item in {**own, **shared}.items() if key not in ("options", "as_json")}
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters = [_declared(item).replace(kind=keyword) for item in listed.values()]
        parameters.append(inspect.Parameter("as_json", keyword, default=False, annotation=JsonOption))
        # Typer reads both.
        called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        called.__annotations__ = {item.name: item.annotation for item in parameters}
        group, _, last = name.rpartition(" ")
        return _apps[group].command(last, cls=CommandOfSingleValues)(called)

    return decorate


def _declared(item: inspect.Parameter) -> inspect.Parameter:
    """The parameter with what `typer` needs to know: a text is the help of an option, or without default an argument.

    An option has the name of the parameter unless it states another one.
    """
    kind, declared = get_args(item.annotation)
    if isinstance(declared, str):
        declared = typer.Argument(help=declared) if item.default is item.empty else typer.Option(help=declared)
    if isinstance(declared, OptionInfo) and declared.default is ...:  # typer takes the first name for a default
        declared = copy(declared)
        declared.param_decls = (f"--{item.name.strip('_').replace('_', '-')}",)
    return item.replace(annotation=Annotated[kind, declared])


def run(name: str, as_json: bool, work: Callable[[], Outcome]) -> None:
    """Do the work of the command `name`, print its outcome, and turn errors into messages and exit codes."""
    try:
        outcome = work()
    except ScancellError as error:
        _fail(name, as_json, error.in_options(options_by_argument(name)), type(error).__name__, EXIT_ERROR)
    except KeyboardInterrupt:
        _fail(name, as_json, "interrupted", "KeyboardInterrupt", EXIT_INTERRUPTED)
    for line in outcome.text:
        print(line, file=sys.stderr if as_json else sys.stdout)
    if outcome.warnings:
        options = options_by_argument(name)
        outcome = replace(outcome, warnings=[named_by(warning, options) for warning in outcome.warnings])
    for warning in outcome.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if as_json:
        fields = {key: getattr(outcome, key) for key in ("figures", "files", "warnings", "timings")}
        print(json.dumps({"command": name, "ok": True, **fields}))
    if outcome.code:
        raise typer.Exit(outcome.code)


def options_by_argument(name: str) -> dict[str, str]:
    """Options of a command by their words, and by the arguments of the Python functions that they set."""
    found: Any = typer.main.get_command(app)
    for word in name.split():
        found = found.commands[word]
    options = {item.name: item.opts[-1] for item in found.params if item.param_type_name == "option"}
    words = {option.removeprefix("--").replace("-", "_"): option for option in options.values()}
    return words | options | {argument: options[key] for argument, key in _RENAMED.items() if key in options}


def _fail(name: str, as_json: bool, message: str, kind: str, code: int) -> NoReturn:
    print(f"scancell: {message}", file=sys.stderr)
    if as_json:
        print(json.dumps({"command": name, "ok": False, "error": {"kind": kind, "message": message}}))
    sys.stdout.flush()
    raise typer.Exit(code)


def show_progress(as_json: bool) -> AbstractContextManager[Progress]:
    """Progress bars on a terminal, else none; every report of progress can raise a pending interrupt."""
    if as_json or not sys.stderr.isatty():
        return interruptible(NullProgress())
    from scancell.cli.terminal import TerminalProgress  # noqa: PLC0415  (rich takes 0.1 s to import)

    return interruptible(TerminalProgress())


PartArgument = Annotated[Path, "mesh (STL, OBJ, PLY), CAD file (STEP, IGES, BREP) or artefact (TOML)"]
CellOption = Annotated[Path | None, "cell description (TOML)"]
SensorOption = Annotated[Path | None, "sensor description (TOML)"]
ScanOption = Annotated[Path | None, "scan description (TOML)"]
PathOption = Annotated[Path | None, "sensor path (TOML) instead of the views of the scan description"]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar=KEY_VALUE, help="change the nominal description: cell.part.x_mm=20; repeatable"),
]
AsBuiltOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar=KEY_VALUE, help="perturb the true cell: tool.x_mm=0.1, sensor.laser.turn_y_deg=0.1; repeatable"
    ),
]
EngineOption = Annotated[Engine, "rendered camera images, or ideal ray intersection"]
IdealOption = Annotated[bool, "switch off all noise but speckle"]
SeedOption = Annotated[int, typer.Option(min=0, max=2**31 - 1, help="random seed")]
UnitOption = Annotated[str, "unit of the mesh file: mm, m or inch"]
CloudUnitOption = Annotated[LengthUnit | None, "unit of the cloud file; by default what the file states, or else mm"]
ThreadsOption = Annotated[int, typer.Option(min=0, help="number of threads; 0 for one per core")]
WorkersOption = Annotated[int, typer.Option(min=0, help="processes on this machine; 0: one per core")]
FormatsOption = Annotated[
    str, typer.Option("--format", help="formats of the cloud, separated by commas: ply, npz, laz, e57, pcd, xyz")
]
OutOption = Annotated[Path, typer.Option(help="folder for the results")]
TablePartOption = Annotated[Path | None, "mesh of the part; the table is empty without this option"]
CharacteristicsOption = Annotated[
    Path | None, "toleranced characteristics (TOML): views are chosen so that each can be decided"
]
NoGuardOption = Annotated[bool, "run without the collision guard"]


@dataclass(frozen=True)
class Options:
    """Options of a command."""

    as_json: JsonOption = False

    @property
    def given(self) -> dict[str, Any]:
        """Arguments of the Python function behind the command: the options that have a value."""
        return {name: value for name, value in vars(self).items() if value is not None and name != "as_json"}


@dataclass(frozen=True)
class PartOptions(Options):
    """Options of commands that load a cell with a part."""

    cell: CellOption = None
    sensor: SensorOption = None
    settings: SetOption = None
    unit: UnitOption = "mm"
    threads: ThreadsOption = 0

    def setup(self, scan: Path | None = None, path: Path | None = None, settings: Sequence[str] = ()) -> Setup:
        """The descriptions that the options name."""
        from scancell.config.loading import with_path  # noqa: PLC0415

        words = [*(self.settings or []), *settings]
        return with_path(scancell.load_setup(self.cell, self.sensor, scan, words, self._is_ideal), path)

    @property
    def _is_ideal(self) -> bool:
        return False


def words_of_features(characteristics: Path | None) -> list[str]:
    """Settings by which views are chosen for a description of characteristics; none without one."""
    if characteristics is None:
        return []
    from scancell.config.inspection import InspectionDescription  # noqa: PLC0415

    goals = []
    for one in InspectionDescription.from_toml(characteristics).feature_goals():
        faces = json.dumps(one.faces, ensure_ascii=False)
        deviation = f", deviation_um = {one.deviation_um!r}" if one.deviation_um else ""
        goals.append(f'{{ faces = {faces}, of = "{one.of}", share = {one.share!r}{deviation} }}')
    return ["scan.coverage.enabled=true", f"scan.coverage.feature=[{', '.join(goals)}]"]


@dataclass(frozen=True)
class SimulationOptions(PartOptions):
    """Options of commands that simulate measurements in the cell."""

    as_built: AsBuiltOption = None
    ideal: IdealOption = False
    seed: SeedOption = 0

    @property
    def _is_ideal(self) -> bool:
        return self.ideal


@dataclass(frozen=True)
class CellOptions(SimulationOptions):
    """Options of commands that expose the sensor with a choice of the engine."""

    engine: EngineOption = "ray-traced"


@dataclass(frozen=True)
class CloudOptions(CellOptions):
    """Options of commands that write a cloud into a run folder."""

    images: Annotated[bool, "keep the camera images of every exposure"] = False
    formats: FormatsOption = "ply"
    estimated_sensor: Annotated[
        Path | None, "calibrated sensor (TOML) that interprets the images of the sensor as built"
    ] = None
    frame: Annotated[
        CloudFrame,
        "frame of the points in the cloud files; table, base and world: table at 0; belt: of a scan on a belt",
    ] = "part"

    def run_into(
        self, out: Path, setup: Setup, progress: Progress, scan: Callable[[dict[str, Any]], ScanResult]
    ) -> Outcome:
        """Make a scan with the options and write its files into `out`, all or none."""
        from scancell.output.image_files import ImageWriter  # noqa: PLC0415
        from scancell.output.run_folder import OPTIONAL_FILES, RunFolder  # noqa: PLC0415
        from scancell.reconstruction.cloud_files import parse_formats  # noqa: PLC0415

        formats = parse_formats(self.formats, "formats")
        given: dict[str, Any] = {
            "unit": self.unit,
            "engine": self.engine,
            "as_built": self.as_built or (),
            "seed": self.seed,
        }
        if self.estimated_sensor is not None:
            given["estimated_sensor"] = scancell.SensorDescription.from_toml(self.estimated_sensor)
        with RunFolder(out, OPTIONAL_FILES) as folder:
            if self.images and self.engine == "geometric":
                raise DescriptionError(
                    "the geometric engine makes no images", key="images", expected="--engine ray-traced"
                )
            images = ImageWriter(folder, setup) if self.images else None
            result = scan({**given, "on_images": images, "progress": progress}).evaluate(progress)
            if images is not None:
                images.finish()
            result.save_into(folder, formats, frame=self.frame)
        lines = [result.summary(), f"  results    {out}"]
        files = [str(path) for path in folder.paths]
        return Outcome(lines, result.figures, files, list(result.warnings), result.timings)
