"""Random and mutated packets between cell and guard: ``python -m bench.guard_packets [--packets N] [--udp N]``.

PYTHONPATH=tests. Mutants of a packet are sent before it, to both ends of a session in this process and, a part of them,
to a server over UDP. None of them may count; the packet itself must. ``--guard N`` of them are sent to
``scancell guard serve`` with a part, between states that are valid, but whose values are anywhere in their bounds: each
must be answered without an error of the guard.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import socket
import struct
import subprocess
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from guard_answers import HANGS, guard_process
from scancell.cell.driver import Mode, Operation
from scancell.config.loading import load_setup
from scancell.guard.endpoints import FAILED, LEAST_PERIOD, SILENCE, CellEndpoint, GuardEndpoint, Outcome
from scancell.guard.messages import CellState, GuardMessage, PlacedPart, decode

MUTANTS = 16  # of a packet
SESSION_LENGTH = 200  # exchanges
PERIOD = 0.032  # s
TEXTS = ("", "joint 1 → wall 20 mm", "é" * 60)

COMMAND = [sys.executable, "-c", "from scancell.cli import main; main()"]
PART = Path(__file__).resolve().parents[2] / "assets" / "parts" / "step_block.stl"

_HEADER, _CRC = 28, 4  # bytes
_BAD = struct.pack("<d", np.nan), struct.pack("<d", np.inf), struct.pack("<d", -1e300)
_DOUBLES = {1: (28, 36, 44, 52, 76), 2: (32, 40)}  # offsets by kind
_BYTES = {1: (60, 61, 62, 63, 65, 74, 75), 2: (48, 49, 50)}


def random_state(rng: np.random.Generator, sequence: int, joints: int | None = None) -> CellState:
    """State number `sequence`, of any arm."""
    axes = (joints or int(rng.integers(1, 9))) + 1
    rows = int(rng.integers(0, 65)) if rng.random() < 0.2 else 0
    return CellState(
        sequence % 2**32,
        sequence * PERIOD,
        Operation(int(rng.integers(2))),
        Mode(int(rng.integers(6))),
        bool(rng.integers(2)),
        rng.uniform(-7, 7, axes),
        float(rng.random()),
        rng.uniform(-7, 7, (rows, axes)),
        0.016 if rows else 0.0,
        float(rng.uniform(-1, sequence * PERIOD)) if rows else 0.0,
        widths=rng.uniform(0, 0.1, int(rng.integers(3))),
        parts=tuple(_random_part(rng, number) for number in range(1, int(rng.integers(1, 4)))),
        prismatic=int(rng.integers(2**axes)),
        digest=int(rng.integers(2**32)),
    )


def _random_part(rng: np.random.Generator, number: int) -> PlacedPart:
    quaternion = rng.normal(size=4)
    place = (*rng.uniform(-1, 1, 3), *(quaternion / np.linalg.norm(quaternion)))
    return PlacedPart(number, int(rng.integers(3)), tuple(float(value) for value in place))


def extreme_states(rng: np.random.Generator, joints: int) -> Iterator[CellState]:
    """States of one session whose values are anywhere in their bounds, by orders of magnitude; times increase."""
    time, axes = _anywhere(rng, -1e9, 0.0), rng.uniform(-3, 3, joints + 1)
    for sequence in range(2**32):
        time += LEAST_PERIOD + 1e-6 + float(rng.choice([0.0, PERIOD, _anywhere(rng, 0.0, 1e3)]))
        step = 10.0 ** rng.uniform(-12, 4)
        axes = np.clip(axes + step * rng.uniform(-1, 1, joints + 1), -1e4, 1e4)
        if rng.random() < 0.3:
            axes = rng.uniform(-3, 3, joints + 1)
        is_automatic = rng.random() < 0.6
        rows = int(rng.integers(0, 65)) if is_automatic or rng.random() < 0.5 else 0
        steps = 10.0 ** rng.uniform(-12, 4) * rng.uniform(-1, 1, (rows, joints + 1))
        yield CellState(
            sequence,
            time,
            Operation(int(is_automatic)),
            Mode(int(rng.integers(7))),
            bool(rng.integers(4)),
            axes,
            _anywhere(rng, 0.0, 1.0),
            np.clip(axes + np.cumsum(steps, 0), -1e4, 1e4),
            _anywhere(rng, 1e-3, 10.0) if rows else 0.0,
            min(_anywhere(rng, -1e9, 1e9), time) if rows else 0.0,
        )


def _anywhere(rng: np.random.Generator, low: float, high: float) -> float:
    """A bound, or a number between: equally distributed, or by its order of magnitude from the smallest one on."""
    magnitude = 10.0 ** rng.uniform(-323.5, np.log10(max(abs(low), abs(high))))
    drawn = rng.choice([low, high, magnitude, -magnitude, rng.uniform(low, high), rng.uniform(low, high)])
    return float(np.clip(drawn, low, high))


def random_answer(rng: np.random.Generator, sequence: int, state_sequence: int, state_time: float) -> GuardMessage:
    """Answer number `sequence`."""
    flags = bool(rng.integers(2)), str(rng.choice(TEXTS)), bool(rng.integers(2))
    return GuardMessage(sequence % 2**32, state_sequence, state_time, float(rng.random()), *flags)


class AnyAnswers:
    """A guard with random answers."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._sequence = 0

    def answer(self, state: CellState) -> GuardMessage:
        self._sequence += 1
        return random_answer(self._rng, self._sequence, state.sequence, state.time)

    def reset(self) -> None:
        self._sequence = 0


class Traffic:
    """Random and mutated packets.

    Attributes
    ----------
    ways
        What is sent in place of a packet.
    """

    def __init__(self, seed: int) -> None:
        self._seed, self.rng = seed, np.random.default_rng(seed)
        self._earlier: list[bytes] = []
        self.ways: dict[str, Callable[[bytes], bytes]] = {
            "random bytes": lambda packet: self._random(int(self.rng.integers(0, 300))),
            "random bytes after the first 8 of the packet": lambda packet: packet[:8] + self._random(len(packet) - 8),
            "bits flipped": self._flipped,
            "bytes replaced": self._replaced,
            "truncated": lambda packet: packet[: int(self.rng.integers(len(packet)))],
            "extended": lambda packet: packet + self._random(int(self.rng.integers(1, 50))),
            "bytes removed or inserted": self._shifted,
            "spliced with an earlier packet": self._spliced,
            "earlier packet": lambda packet: self._any_earlier(),
            "random body, CRC right": lambda packet: _sealed(packet[:_HEADER] + self._random(len(packet) - 32)),
            "value out of bounds, CRC right": self._out_of_bounds,
            "other version or kind, CRC right": self._other_format,
            "other session, CRC right": lambda packet: _sealed(packet[:8] + self._random(16) + packet[24:-_CRC]),
        }
        self._names = list(self.ways)

    def remember(self, packet: bytes) -> None:
        """A packet was accepted."""
        self._earlier = [*self._earlier[-50:], packet]

    def mutant(self, packet: bytes) -> tuple[str, bytes]:
        """Another packet, and in which way it is different."""
        while True:
            way = self._names[int(self.rng.integers(len(self._names)))]
            made = self.ways[way](packet)
            if made != packet:
                return way, made

    def _random(self, length: int) -> bytes:
        return self.rng.bytes(length)

    def _any_earlier(self) -> bytes:
        return self._earlier[int(self.rng.integers(len(self._earlier)))] if self._earlier else b""

    def _flipped(self, packet: bytes) -> bytes:
        changed = bytearray(packet)
        for bit in self.rng.integers(0, 8 * len(packet), int(self.rng.integers(1, 6))):
            changed[bit // 8] ^= 1 << bit % 8
        return bytes(changed)

    def _replaced(self, packet: bytes) -> bytes:
        at, length = int(self.rng.integers(len(packet))), int(self.rng.integers(1, 40))
        return (packet[:at] + self._random(length) + packet[at + length :])[: len(packet)]

    def _shifted(self, packet: bytes) -> bytes:
        at, length = int(self.rng.integers(len(packet))), int(self.rng.integers(1, 9))
        if self.rng.random() < 0.5:
            return packet[:at] + packet[at + length :]
        return packet[:at] + self._random(length) + packet[at:]

    def _spliced(self, packet: bytes) -> bytes:
        at = int(self.rng.integers(len(packet)))
        return packet[:at] + self._any_earlier()[at:]

    def _out_of_bounds(self, packet: bytes) -> bytes:
        kind = packet[5]
        if self.rng.random() < 0.5:
            at, new = int(self.rng.choice(_DOUBLES[kind])), _BAD[int(self.rng.integers(3))]
        else:
            at, new = int(self.rng.choice(_BYTES[kind])), bytes([int(self.rng.integers(121, 256))])
        return _sealed(packet[:at] + new + packet[at + len(new) : -_CRC])

    def _other_format(self, packet: bytes) -> bytes:
        at = int(self.rng.integers(4, 6))
        return _sealed(packet[:at] + bytes([int(self.rng.integers(256))]) + packet[at + 1 : -_CRC])


def _sealed(packet: bytes) -> bytes:
    return packet + struct.pack("<I", zlib.crc32(packet))


def run_in_process(traffic: Traffic, packets: int, counts: Counter[str]) -> None:
    """Send mutants to both ends of sessions in this process; `counts` says what was accepted."""
    guard, cell = GuardEndpoint(AnyAnswers(0)), CellEndpoint(age_limit=0.1)
    sequence = 0
    while counts["mutants"] < packets:
        if sequence % SESSION_LENGTH == 0:
            cell.reset()
        now = sequence * PERIOD + 1e3 * (1 + sequence // SESSION_LENGTH)
        packet = cell.packet(replace(random_state(traffic.rng, sequence), time=now))
        mutants = min(MUTANTS, packets - counts["mutants"])
        _send(traffic, mutants, packet, partial(guard.receive, now=now), counts)
        answer = guard.answer()
        assert answer is not None
        mutants = min(MUTANTS, packets - counts["mutants"])
        _send(traffic, mutants, answer, partial(cell.receive, now=now), counts)
        sequence += 1
    for outcome in Outcome:
        counts[f"outcome {outcome}"] += guard.counts[outcome] + cell.counts[outcome]


def _send(
    traffic: Traffic, mutants: int, packet: bytes, receive: Callable[[bytes], object], counts: Counter[str]
) -> None:
    """Send mutants of a packet, and the packet."""
    for _ in range(mutants):
        way, mutant = traffic.mutant(packet)
        is_accepted = bool(receive(mutant))
        counts["mutants"] += 1
        counts["accepted mutants"] += is_accepted
        counts[f"{way}: sent"] += 1
        counts[f"{way}: accepted"] += is_accepted
    counts["genuine packets"] += 1
    counts["accepted genuine packets"] += bool(receive(packet))
    traffic.remember(packet)


def run_over_udp(traffic: Traffic, packets: int, counts: Counter[str]) -> None:
    """Send mutants to a server over UDP; every packet is answered before the next mutants."""
    cell = CellEndpoint(age_limit=HANGS)
    with guard_process("udp") as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.connect(("127.0.0.1", server.port))
        own.settimeout(HANGS)
        sent = sequence = 0
        while sent < packets:
            state = random_state(traffic.rng, sequence, joints=6)
            packet = cell.packet(state)
            # Before the session is open, a mutant with a number of its own could open one.
            for _ in range(min(MUTANTS, packets - sent) if sequence else 0):
                own.send(traffic.mutant(packet)[1])
                sent += 1
            own.send(packet)
            answer = own.recv(2048)
            assert decode(answer).message.state_sequence == state.sequence
            assert cell.receive(answer, state.time) is not None
            traffic.remember(packet)
            sequence += 1
        assert server.end() == 0
        accepted = server.counts.pop(Outcome.ACCEPTED)
        counts["UDP: accepted mutants"] += accepted - sequence
        counts["UDP: genuine packets, all accepted"] += sequence
        counts["UDP: mutants sent"] += sent
        for outcome, number in server.counts.items():
            counts[f"UDP: outcome {outcome}"] += number


@contextlib.contextmanager
def served_guard(counts: Counter[str]) -> Iterator[int]:
    """Port of ``scancell guard serve`` with a part; packets that it counted are in `counts` at the end."""
    command = [*COMMAND, "guard", "serve", "--part", str(PART), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        yield int(process.stderr.readline().split()[-1])
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=HANGS)
        assert process.returncode == 0, err
        counts.update(json.loads(out.splitlines()[-1])["figures"]["packets"])
    finally:
        process.kill()
        process.communicate()


def run_against_guard(traffic: Traffic, packets: int, counts: Counter[str]) -> None:
    """Send extreme states and mutants of them to a guard of the default cell, over UDP."""
    served: Counter[str] = Counter()
    longest, cell = 0.0, CellEndpoint(age_limit=HANGS)
    with served_guard(served) as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.connect(("127.0.0.1", port))
        own.settimeout(HANGS)
        sent = states = 0
        while sent < packets:
            for sequence, state in enumerate(extreme_states(traffic.rng, joints=6)):
                if sequence == SESSION_LENGTH or sent >= packets or state.time > 9e8:
                    break
                packet = cell.packet(state)
                for _ in range(min(MUTANTS // 2, packets - sent) if sequence else 0):
                    own.send(traffic.mutant(packet)[1])
                    sent += 1
                start = time.perf_counter()
                own.send(packet)
                answer = own.recv(2048)
                longest = max(longest, time.perf_counter() - start)
                assert cell.receive(answer, state.time) is not None
                traffic.remember(packet)
                states += 1
            time.sleep(1.1 * SILENCE)  # until another session may begin
            cell.reset()
    assert served[FAILED] == 0
    assert served[Outcome.ACCEPTED] == states
    counts["guard: mutants sent, none accepted"] += sent
    counts["guard: extreme states, all answered"] += states
    counts["guard: longest answer, ms"] = round(1e3 * longest)


_FLOOD = """import socket, sys
own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
while True:
    own.sendto(bytes(1000), ("127.0.0.1", int(sys.argv[1])))
"""


def run_beside_flood(states: int, counts: Counter[str]) -> None:
    """Send states every 32 ms to a guard of the default cell beside a process that floods its port."""
    served: Counter[str] = Counter()
    cell = CellEndpoint(age_limit=0.12)
    home = np.radians([*load_setup().cell.robot.home_deg, 0.0])
    with served_guard(served) as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.connect(("127.0.0.1", port))
        own.settimeout(PERIOD)
        flood = subprocess.Popen([sys.executable, "-c", _FLOOD, str(port)])
        try:
            for sequence in range(states):
                start = time.perf_counter()
                now = sequence * PERIOD
                state = CellState(
                    sequence, now, Operation.MANUAL, Mode.JOINT_JOG, True, home + 1e-3 * sequence * PERIOD
                )
                own.send(cell.packet(state))
                while (left := start + PERIOD - time.perf_counter()) > 0:
                    own.settimeout(left)
                    with contextlib.suppress(TimeoutError):
                        counts["flood: answers"] += cell.receive(own.recv(2048), now) is not None
        finally:
            flood.kill()
            flood.wait()
    counts["flood: states"] += states
    counts["flood: foreign datagrams refused"] += served[Outcome.MALFORMED]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.guard_packets", description=__doc__)
    parser.add_argument("--packets", type=int, default=1_000_000, help="mutants in all")
    parser.add_argument("--udp", type=int, default=200_000, help="of these, over UDP")
    parser.add_argument("--guard", type=int, default=100_000, help="further mutants, to a guard with a part over UDP")
    parser.add_argument("--flood", type=int, default=150, help="states of a cell beside a flood")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    start = time.perf_counter()
    run_in_process(Traffic(options.seed), options.packets - options.udp, counts)
    run_over_udp(Traffic(options.seed + 1), options.udp, counts)
    run_against_guard(Traffic(options.seed + 2), options.guard, counts)
    run_beside_flood(options.flood, counts)
    for name, number in counts.items():
        print(f"{number:>10,} {name}")
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
