"""Validation of the messages of browsers: any program that reaches the server can send other ones.

Viser checks neither sizes nor types of messages, and raises errors in its own threads, where they are lost. So the kind
of a message, the types and sizes of its fields, and the new value of an input are checked before viser receives it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import msgspec

_MOST_UPLOADED = 1 << 28  # bytes of files that a browser has begun to send
_MOST_PARTS = 10_000  # of such a file
_MOST_TEXT = 10_000
_LARGEST = 1e9

_Number = Annotated[float, msgspec.Meta(ge=-_LARGEST, le=_LARGEST)]
_Count = Annotated[int, msgspec.Meta(ge=0, le=_MOST_UPLOADED)]
_Text = Annotated[str, msgspec.Meta(max_length=_MOST_TEXT)]
_Vector = tuple[_Number, _Number, _Number]
_Quaternion = tuple[_Number, _Number, _Number, _Number]


class _Message(msgspec.Struct, tag=lambda name: name.strip("_"), forbid_unknown_fields=True):
    """Message of viser with the same name."""


class _ViewerCameraMessage(_Message):
    wxyz: _Quaternion
    position: _Vector
    fov: _Number
    near: _Number
    far: _Number
    image_height: _Count
    image_width: _Count
    look_at: _Vector
    up_direction: _Vector


class _GuiUpdateMessage(_Message):
    uuid: _Text
    updates: dict[str, bool | int | _Number | _Text | list[_Number]]


class _GuiButtonHoldMessage(_Message):
    uuid: _Text
    frequency: _Number


class _CommandTriggerMessage(_Message):
    uuid: _Text


class _FileTransferStartUpload(_Message):
    source_component_uuid: _Text
    transfer_uuid: _Text
    filename: _Text
    mime_type: _Text
    part_count: Annotated[int, msgspec.Meta(ge=0, le=_MOST_PARTS)]
    size_bytes: _Count


class _FileTransferPart(_Message):
    source_component_uuid: _Text | None
    transfer_uuid: _Text
    part_index: _Count
    content: bytes


class _FileTransferPartAck(_Message):
    source_component_uuid: _Text | None
    transfer_uuid: _Text
    transferred_bytes: int
    total_bytes: int


class _TransformControlsUpdateMessage(_Message):
    name: _Text
    wxyz: _Quaternion
    position: _Vector
    owner: _Text = ""


class _TransformControlsDragStartMessage(_Message):
    name: _Text
    owner: _Text = ""


class _TransformControlsDragEndMessage(_Message):
    name: _Text
    owner: _Text = ""


class _SceneNodeClickMessage(_Message):
    name: _Text
    instance_index: int | None
    ray_origin: _Vector
    ray_direction: _Vector
    screen_pos: tuple[_Number, _Number]
    modifier: _Text | None = None
    owner: _Text = ""


class _GetRenderResponseMessage(_Message):
    payload: bytes
    render_uuid: _Text


_KINDS = (
    _ViewerCameraMessage
    | _GuiUpdateMessage
    | _GuiButtonHoldMessage
    | _CommandTriggerMessage
    | _FileTransferStartUpload
    | _FileTransferPart
    | _FileTransferPartAck
    | _TransformControlsUpdateMessage
    | _TransformControlsDragStartMessage
    | _TransformControlsDragEndMessage
    | _SceneNodeClickMessage
    | _GetRenderResponseMessage
)


class Gate:
    """Validates the messages of one connection.

    Parameters
    ----------
    handle_of
        Returns the input with an identifier, or None.
    """

    def __init__(self, handle_of: Callable[[str], Any]) -> None:
        self._handle_of = handle_of
        self._decoder = msgspec.msgpack.Decoder(_KINDS)
        self._uploads: dict[str, tuple[set[int], int]] = {}  # parts that are due, and bytes, by transfer
        self._uploaded = 0

    def refusal(self, frame: object) -> str:
        """Reason for rejecting a frame; empty if it is accepted."""
        if not isinstance(frame, bytes):
            return "a text frame"
        try:
            message = self._decoder.decode(frame)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return str(error)
        match message:
            case _GuiUpdateMessage():
                return self._update_refusal(message)
            case _FileTransferStartUpload():
                return self._begin_upload(message)
            case _FileTransferPart():
                return self._take_part(message)
        return ""

    def _update_refusal(self, message: _GuiUpdateMessage) -> str:
        handle = self._handle_of(message.uuid)
        if handle is None:  # it has just been removed
            return "no such input"
        if list(message.updates) != ["value"]:
            return f"{list(message.updates)}: expected a value"
        value = message.updates["value"]
        expected = value_expected(handle, value)
        return f"{getattr(handle, 'label', 'input')} = {str(value)[:40]}: expected {expected}" if expected else ""

    def _begin_upload(self, message: _FileTransferStartUpload) -> str:
        if getattr(self._handle_of(message.source_component_uuid), "mime_type", None) is None:
            return f"{message.filename[:80]}: no input for a file"
        if message.size_bytes + self._uploaded > _MOST_UPLOADED:
            return f"{message.filename[:80]}: expected at most {_MOST_UPLOADED / 1e6:.0f} MB"
        if message.transfer_uuid in self._uploads:
            return f"{message.filename[:80]}: it is being sent already"
        if not message.part_count and message.size_bytes:
            return f"{message.filename[:80]}: expected parts"
        if message.part_count:
            self._uploads[message.transfer_uuid] = set(range(message.part_count)), message.size_bytes
            self._uploaded += message.size_bytes
        return ""

    def _take_part(self, message: _FileTransferPart) -> str:
        due, left = self._uploads.get(message.transfer_uuid, (set[int](), 0))
        left -= len(message.content)
        if message.part_index not in due or left < 0 or (len(due) == 1 and left > 0):
            return "a part of a file that is not expected"
        due.remove(message.part_index)
        self._uploads[message.transfer_uuid] = due, left
        if not due:
            del self._uploads[message.transfer_uuid]
            self._uploaded = sum(left for _, left in self._uploads.values())
        return ""


def value_expected(handle: Any, value: object) -> str:
    """Values that an input of viser accepts in place of `value`; empty if it accepts `value`."""
    options, now = getattr(handle, "options", None), handle.value
    if options is not None:
        return "" if value in options else f"one of {', '.join(map(str, options))}"
    if isinstance(now, bool):
        return "" if isinstance(value, bool) else "true or false"
    if isinstance(now, int | float):
        low, high = getattr(handle, "min", None), getattr(handle, "max", None)
        slack = 0.0 if getattr(handle, "step", None) is None else handle.step  # pages round to steps
        low, high = -_LARGEST if low is None else low - slack, _LARGEST if high is None else high + slack
        is_inside = isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high
        return "" if is_inside else f"a number from {low:g} to {high:g}"
    if isinstance(now, str):
        return "" if isinstance(value, str) else "text"
    if type(now) is tuple:  # a file is a tuple with names
        return "" if isinstance(value, list) and len(value) == len(now) else f"{len(now)} numbers"
    return "no value"
