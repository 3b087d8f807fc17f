"""The exception tree: every error that a person can cause or mend derives from `ScancellError`."""


class ScancellError(Exception):
    """An error with a message for people: it names the file, the key, the value and what was expected."""


class DescriptionError(ScancellError):
    """A cell, sensor or scan description is wrong (unknown key, missing key, value out of bounds)."""


class MeshError(ScancellError):
    """A mesh file is missing, unreadable, empty or broken."""


class PlanningError(ScancellError):
    """A scan cannot be carried out: unreachable, outside limits, or colliding poses."""


class CellError(ScancellError):
    """The FMU refused a call or reported an error."""


class CommandError(CellError):
    """The cell's controller refused a command, stopped it, or did not finish it in time."""


class ProgramError(ScancellError):
    """A robot program failed; the message states its file and line."""


class SensorError(ScancellError):
    """The sensor library refused its input."""


class CalibrationError(ScancellError):
    """Measured data do not determine what is to be calibrated; the message states what is missing."""


class ImageError(ScancellError):
    """An image file is missing, unreadable, or not what the sensor's description says."""


class OutputError(ScancellError):
    """A result cannot be written."""


class EngineError(ScancellError):
    """Work cannot be distributed, or whoever distributed it is gone."""


class MessageError(ScancellError):
    """A message between cell and guard is malformed, or holds a value outside its bounds."""


class LinkError(ScancellError):
    """No socket can be opened: between cell and guard, or for browsers."""


class FitError(ScancellError):
    """Points do not determine a geometric element; the message states what is missing."""


class EmptyScanError(ScancellError):
    """A scan gave no point of the part; the message states the cause and the key to change."""


class CancelledError(ScancellError):
    """The progress callback asked to stop."""


class MissingExtraError(ScancellError):
    """A package of an optional extra is not installed; the message states the command that installs it."""
