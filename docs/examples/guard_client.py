"""A cell for the guard without scancell: joint 1 turns until the guard stops it. ``guard_client.py HOST PORT``"""

import secrets
import socket
import struct
import sys
import time
import zlib

PERIOD, AGE_LIMIT = 0.032, 1.0  # s
session, guard, last, sent = secrets.randbelow(2**64 - 1) + 1, 0, None, {}  # guard: from its first answer on


def state(sequence: int, now: float, *axes: float) -> bytes:
    """State of six joints and a table in manual operation (0), jogging joints (4), moving (1), no path ahead."""
    header = (b"SCGD", 1, 1, 126, session, guard, sequence)
    packet = struct.pack("<4sBBHQQIddddBBBBH7d", *header, now, 1.0, 0.0, 0.0, 0, 4, 1, 6, 0, *axes)
    return packet + struct.pack("<I", zlib.crc32(packet))


def answer(packet: bytes, now: float) -> tuple[float, int, str] | None:
    """Monitor speed, emergency stop and text of an answer that counts; `struct.error` if it is too short."""
    global guard, last
    header = struct.unpack_from("<4sBBHQ", packet)
    of_guard, number, answered, measured, speed, stop, _, size = struct.unpack_from("<QIIddBBB", packet, 16)
    is_whole = len(packet) == 55 + size and zlib.crc32(packet[:-4]) == int.from_bytes(packet[-4:], "little")
    is_ours = header == (b"SCGD", 1, 2, 55 + size, session) and guard in (0, of_guard)
    is_new = sent.get(answered) == measured and (last is None or 0 < (number - last) % 2**32 < 2**31)
    if not (is_whole and is_ours and is_new and now - measured <= AGE_LIMIT and 0 <= speed <= 1):
        return None
    guard, last = of_guard, number
    return speed, stop, packet[51:-4].decode()


link, angle, heard = socket.socket(type=socket.SOCK_DGRAM), 0.0, time.monotonic()
link.connect((sys.argv[1], int(sys.argv[2])))
link.settimeout(PERIOD)
for sequence in range(10_000):
    now = sent[sequence] = time.monotonic()
    try:
        link.send(state(sequence, now, angle, -1.2, 0.7, 0.1, 0.4, -2.0, 0.0))
        found = answer(link.recv(2048), time.monotonic())
    except (OSError, struct.error):
        found = None
    if found:
        print(f"joint 1 at {angle:.3f} rad: {found[2]}")
        angle, heard = angle + 1.0 * PERIOD, now
    if (found and found[1]) or now - heard > AGE_LIMIT:
        sys.exit("emergency stop by the guard" if found else "stopped: no answer")
    time.sleep(PERIOD)
