"""RTDE as the server of one client: bytes in, bytes out, without sockets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scancell.errors import MessageError
from scancell.wire.ur.packets import (
    IN_USE,
    NOT_FOUND,
    PROTOCOL_VERSION,
    Kind,
    Level,
    Packet,
    PacketBuffer,
    Recipe,
    controller_version,
    names_from,
    outputs_request_from,
    packed,
    recipe_answer,
    text_message,
    text_message_from,
    version_from,
)
from scancell.wire.ur.variables import INPUTS, OUTPUTS, reading, written

if TYPE_CHECKING:
    from scancell.wire.ur.controller import UrController

_MAX_RECIPES = 255  # of inputs, of one client
_MAX_TEXTS = 100  # of one client that are shown
_ACCEPTED, _REFUSED = b"\1", b"\0"


class RtdeServer:
    """One client's connection to RTDE.

    Attributes
    ----------
    is_open
        False after bytes that are no packets: the connection is to be closed.
    is_started
        Whether the client receives data.
    """

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self._buffer = PacketBuffer()
        self._version = 0
        self._outputs: Recipe | None = None
        self._frequency = 0.0
        self._inputs: dict[int, Recipe] = {}
        self._phase = 0.0  # packages due since the start; the fraction is what is left of the last cycles
        self._texts = 0
        self.is_open, self.is_started = True, False

    def receive(self, received: bytes) -> bytes:
        """Answers to what the client sent."""
        answers = []
        try:
            for packet in self._buffer.packets(received):
                try:
                    answers.append(self._answer(packet))
                except MessageError as error:
                    self._refuse(str(error))
                    answers.append(self._refusal(packet.kind))
        except MessageError as error:
            self._refuse(f"{error}: the connection is closed")
            self.is_open = False
        return b"".join(answers)

    def cycle(self) -> bytes:
        """Data package that is due at the end of a controller cycle; empty if none is."""
        if not self.is_started or self._outputs is None:
            return b""
        self._phase += self._frequency * self._controller.robot.cycle
        if self._phase < 1.0 - 1e-9:
            return b""
        self._phase -= 1.0
        values = [reading(self._controller, name) for name in self._outputs.names]
        return packed(Kind.DATA, self._outputs.pack(values))

    def close(self) -> None:
        """Release the inputs."""
        self._controller.release_inputs(self)

    def _answer(self, packet: Packet) -> bytes:  # noqa: PLR0911
        kind, payload = packet
        if kind == Kind.PROTOCOL_VERSION:
            version = version_from(payload)
            self._version = version if version == PROTOCOL_VERSION else 0
            if not self._version:
                self._refuse(f"protocol version {version}: expected {PROTOCOL_VERSION}")
            return packed(kind, _ACCEPTED if self._version else _REFUSED)
        if kind == Kind.CONTROLLER_VERSION:
            return packed(kind, controller_version(self._controller.version))
        if kind not in list(Kind):
            raise MessageError(key="kind", value=kind, expected="a kind of RTDE packets")
        if not self._version:
            raise MessageError(key="protocol version", value="not negotiated", expected=f"{PROTOCOL_VERSION}")
        if kind == Kind.OUTPUTS:
            return packed(kind, self._set_outputs(*outputs_request_from(payload)))
        if kind == Kind.INPUTS:
            return packed(kind, self._set_inputs(names_from(payload)))
        if kind == Kind.DATA:
            self._take(payload)
            return b""
        if kind == Kind.TEXT:
            text, source, _ = text_message_from(payload)
            self._texts += 1
            if self._texts <= _MAX_TEXTS:
                self._controller.log(f"text of {source!r}: {text!r}")
            return b""
        return packed(kind, self._start_or_pause(is_start=kind == Kind.START))

    def _set_outputs(self, frequency: float, names: list[str]) -> bytes:
        most = 1.0 / self._controller.robot.cycle
        if not 0.0 < frequency <= most * (1.0 + 1e-9):
            raise MessageError(key="frequency", value=frequency, expected=f"above 0, at most {most:g} Hz")
        types = [OUTPUTS.get(name, NOT_FOUND) for name in names]
        if NOT_FOUND in types:
            missing = ", ".join(name for name in names if name not in OUTPUTS)
            self._refuse(f"outputs: no such variable: {missing[:200]}")
            return recipe_answer(0, types)
        self._outputs, self._frequency, self._phase = Recipe(1, names, types), frequency, 0.0
        return recipe_answer(1, types)

    def _set_inputs(self, names: list[str]) -> bytes:
        types = [INPUTS.get(name, NOT_FOUND) for name in names]
        taken = self._controller.inputs_of_others(self)
        types = [IN_USE if name in taken else kind for name, kind in zip(names, types, strict=True)]
        if len(self._inputs) >= _MAX_RECIPES:
            raise MessageError(key="recipes", value=len(self._inputs) + 1, expected=f"at most {_MAX_RECIPES}")
        if NOT_FOUND in types or IN_USE in types:
            wrong = ", ".join(name for name, kind in zip(names, types, strict=True) if kind in (NOT_FOUND, IN_USE))
            self._refuse(f"inputs: unknown, or of another client: {wrong[:200]}")
            return recipe_answer(0, types)
        number = len(self._inputs) + 1
        self._inputs[number] = Recipe(number, names, types)
        self._controller.reserve_inputs(self, names)
        return recipe_answer(number, types)

    def _take(self, payload: bytes) -> None:
        number = payload[0] if payload else 0
        if number not in self._inputs:
            raise MessageError(key="recipe", value=number, expected="the number of an input recipe")
        written(self._controller, self._inputs[number].unpack(payload))

    def _start_or_pause(self, is_start: bool) -> bytes:
        if is_start and self._outputs is None and not self._inputs:
            self._refuse("start: no recipe")
            return _REFUSED
        self.is_started = is_start
        return _ACCEPTED

    def _refuse(self, reason: str) -> None:
        self._controller.refuse("RTDE", reason)

    def _refusal(self, kind: int) -> bytes:
        if kind in (Kind.OUTPUTS, Kind.INPUTS):
            return packed(kind, recipe_answer(0, []))
        if kind in (Kind.PROTOCOL_VERSION, Kind.START, Kind.PAUSE):
            return packed(kind, _REFUSED)
        return packed(Kind.TEXT, text_message("the packet was refused", "scancell", Level.ERROR))
