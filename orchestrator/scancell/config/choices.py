"""Words that descriptions and command lines choose from; without dependencies, so that the command starts fast."""

from __future__ import annotations

from typing import Literal

Engine = Literal["ray-traced", "geometric"]
CalibrationTarget = Literal["tool", "grasp", "table", "belt", "latency", "all"]
FlangeConvention = Literal[
    "matrix", "wxyz", "xyzw", "xyz", "zyz", "xyzwpr", "zyx", "rotvec",
    "xyx", "xzx", "xzy", "yxy", "yxz", "yzx", "yzy", "zxy", "zxz",
]  # fmt: skip
SensorTarget = Literal["ball", "step", "checkered"]
ScanMode = Literal["dynamic", "stop-and-look"]
LengthUnit = Literal["mm", "m", "inch"]
OccupiedFrame = Literal["part", "table", "base", "world"]
CloudFrame = Literal["part", "table", "base", "world", "belt", "flange"]
Align = Literal["none", "best-fit", "datum"]
Reconstruction = Literal["poisson", "ball-pivoting"]
LatencyWord = Literal["estimate"]
TransportProtocol = Literal["udp", "tcp"]

LOOPBACK = "127.0.0.1"  # address on which servers listen by default
