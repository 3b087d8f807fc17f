"""The public names of scancell, by subject. Type checkers read this file; at run time it says what is imported."""

# Calls that do one piece of work
from .api import acceptance as acceptance
from .api import batch as batch
from .api import calibrate as calibrate
from .calibration.board.report import calibrate_from_images as calibrate_from_images
from .api import calibrate_sensor as calibrate_sensor
from .recorded.compare import compare as compare
from .api import capability as capability
from .api import evaluate as evaluate
from .api import inspect as inspect
from .output.extract_images import extract as extract
from .api import layout as layout
from .api import mesh as mesh
from .api import place as place
from .api import plan as plan
from .recorded.result import reconstruct as reconstruct
from .api import render as render
from .api import scan as scan
from .api import shot as shot
from .api import study as study
from .api import survey as survey

# The cell, and what is kept between calls
from .scanner import Scanner as Scanner
from .scanning.session import ScanSession as ScanSession
from .programs.export import export_program as export_program
from .programs.program import run_program as run_program
from .programs.robot import Robot as Robot
from .programs.robot import deg as deg
from .programs.robot import location as location
from .programs.robot import mm as mm

# Descriptions
from .config.cell import CellDescription as CellDescription
from .config.sensor import SensorDescription as SensorDescription
from .config.scan import ScanDescription as ScanDescription
from .config.cell import EstimatedDescription as EstimatedDescription
from .config.loading import Setup as Setup
from .config.loading import load_setup as load_setup
from .config.cell import ChannelDescription as ChannelDescription
from .config.cell import LinkDescription as LinkDescription
from .config.files import assets_dir as assets_dir
from .calibration.cell.scan import CalibrationRequest as CalibrationRequest
from .calibration.sensor.report import SensorCalibrationRequest as SensorCalibrationRequest

from .config.inspection import InspectionDescription as InspectionDescription
from .config.inspection import CharacteristicDescription as CharacteristicDescription
from .config.inspection import DatumDescription as DatumDescription

# Data
from .geometry.mesh import Mesh as Mesh
from .geometry.mesh import box_mesh as box_mesh
from .nominal.parts import load_part as load_part
from .nominal.parts import load_artefact as load_artefact
from .geometry.shapes import ShapeGroup as ShapeGroup
from .geometry import pose as pose
from .planning.plan import Plan as Plan
from .cell.recording import Recording as Recording
from .cell.recording import read_recording as read_recording
from .reconstruction.cloud import Cloud as Cloud
from .scanning.session import Profile as Profile
from .scanning.sense import ExposureImages as ExposureImages

# Results
from .results import ScanResult as ScanResult
from .results import ShotResult as ShotResult
from .scanning.survey import SurveyResult as SurveyResult
from .planning.layout import Layouts as Layouts
from .planning.setups import SetUps as SetUps
from .evaluation.deviation import Deviation as Deviation
from .evaluation.deviation import Coverage as Coverage
from .evaluation.mesh_evaluation import MeshEvaluation as MeshEvaluation
from .evaluation.artefact import ArtefactEvaluation as ArtefactEvaluation
from .calibration.cell.report import CalibrationReport as CalibrationReport
from .calibration.board.report import BoardCalibrationReport as BoardCalibrationReport
from .calibration.sensor.report import SensorCalibrationReport as SensorCalibrationReport
from .output.run_folder import RunReport as RunReport
from .recorded.result import ReconstructionResult as ReconstructionResult
from .recorded.compare import ComparisonResult as ComparisonResult
from .studies.acceptance.report import AcceptanceReport as AcceptanceReport
from .studies.batch import BatchResult as BatchResult
from .studies.report import StudyReport as StudyReport

# The running cell: its controller, its guard, its signals
from .cell.driver import JogFrame as JogFrame
from .cell.driver import Mode as Mode
from .cell.driver import Operation as Operation
from .cell.instance import CellInstance as CellInstance
from .cell.session import CellSession as CellSession
from .cell.instance import SignalLog as SignalLog
from .cell.fmu_file import build_fmu as build_fmu
from .cell.fmu_file import cell_json as cell_json
from .cell.fmu_package import FmuOptions as FmuOptions
from .cell.fmu_file import make_temporary_fmu as make_temporary_fmu
from .nominal.cell import NominalCell as NominalCell
from .nominal.cell import nominal_cell as nominal_cell
from .guard.guard import Guard as Guard
from .guard.guard import GuardedCell as GuardedCell
from .guard.transport import Link as Link
from .guard.transport import faulty_link as faulty_link
from .guard.server import serve_guard as serve_guard
from .guard.messages import CellState as CellState
from .guard.messages import GuardMessage as GuardMessage
from .guard.messages import PlacedPart as PlacedPart
from .guard.parts import PartTracker as PartTracker
from .guard.guard import GuardSettings as GuardSettings
from .guard.transport import InProcess as InProcess
from .guard.transport import TcpTransport as TcpTransport
from .guard.transport import UdpTransport as UdpTransport
from .scanning.session import guard_of as guard_of

# A live cell: commanded while it runs
from .live.cell import LiveCell as LiveCell
from .live.state import LiveState as LiveState
from .live.state import JogJoints as JogJoints
from .live.state import JogSensor as JogSensor
from .live.state import MoveJoints as MoveJoints
from .live.state import MoveAxis as MoveAxis
from .live.state import MoveTool as MoveTool
from .live.state import MoveLine as MoveLine
from .live.state import SetMonitorSpeed as SetMonitorSpeed
from .live.state import SetOperation as SetOperation
from .live.state import Cancel as Cancel
from .live.state import Reset as Reset
from .live.state import OpenGripper as OpenGripper
from .live.state import CloseGripper as CloseGripper
from .live.state import RunConveyor as RunConveyor
from .live.state import JobStopped as JobStopped
from .live.scan import LiveScan as LiveScan
from .live.plan import LivePlan as LivePlan
from .live.camera import CameraFeed as CameraFeed
from .views.mcap_export import SessionRecorder as SessionRecorder

# Pictures of a run
from .views.pictures import animate as animate
from .views.pictures import picture as picture

# Progress
from .progress import Progress as Progress

# Errors
from .errors import CalibrationError as CalibrationError
from .errors import CancelledError as CancelledError
from .errors import CellError as CellError
from .errors import CommandError as CommandError
from .errors import DescriptionError as DescriptionError
from .errors import EmptyScanError as EmptyScanError
from .errors import FitError as FitError
from .errors import ImageError as ImageError
from .errors import LinkError as LinkError
from .errors import MeshError as MeshError
from .errors import MessageError as MessageError
from .errors import MissingExtraError as MissingExtraError
from .errors import OutputError as OutputError
from .errors import PlanningError as PlanningError
from .errors import ProgramError as ProgramError
from .errors import ScancellError as ScancellError
from .errors import SensorError as SensorError
from .errors import WorkersError as WorkersError

__version__: str
