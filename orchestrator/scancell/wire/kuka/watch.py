"""What a guard beside a robot of KUKA must know of RSI."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scancell.arrays import Array
from scancell.errors import MessageError
from scancell.wire.kuka.packets import AXES, Answer, answer_from, answer_packet, state_from

_HELD = 25  # packets of a stop that are answered: what is in force then stays when answers are missing


class RsiInterface:
    """States and corrections of RSI: relative corrections become 0, absolute ones stay, and then no answer follows.

    So the controller ends RSI by its limit of late answers, and stops the motion of its own program as well.

    Parameters
    ----------
    is_absolute
        Whether corrections count from the start of the motion, else from the cycle before.
    """

    port = 49152

    def __init__(self, is_absolute: bool = False) -> None:
        self._is_absolute = is_absolute
        self._last, self._held = Answer(0), 0

    def state(self, packet: bytes) -> tuple[float, Array]:
        """Time (s) and joint angles (joints,) of a state; raises `MessageError` if it is none."""
        ipoc, elements = state_from(packet)
        if not set(AXES) <= set(elements.get("AIPos", {})):
            raise MessageError(
                key="Rob", value=sorted(elements), expected="AIPos, which DEF_AIPos of the configuration sends"
            )
        return 1e-3 * ipoc, np.radians([elements["AIPos"][axis] for axis in AXES])

    def note(self, answer: bytes) -> None:
        """Take notice of an answer; raises `MessageError` if it is none."""
        self._last = answer_from(answer)

    def hold(self, packet: bytes, is_first: bool) -> bytes | None:
        """Answer without new corrections; None after some packets."""
        self._held = 1 if is_first else self._held + 1
        if self._held > _HELD:
            return None
        corrections = self._last.corrections
        if not self._is_absolute:
            corrections = {name: np.zeros(6) for name in corrections}
        return answer_packet(replace(self._last, ipoc=state_from(packet)[0], corrections=corrections))
