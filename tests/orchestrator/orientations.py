"""Orientations as robot controllers state them."""

from __future__ import annotations

# Numbers (n, k) of SciPy rotations (n,) by the name of the convention, angles in rad.
ORIENTATIONS = {
    "matrix": lambda r: r.as_matrix().reshape(-1, 9),
    "wxyz": lambda r: r.as_quat()[:, [3, 0, 1, 2]],
    "xyzw": lambda r: r.as_quat(),
    "xyz": lambda r: r.as_euler("XYZ"),
    "zyz": lambda r: r.as_euler("ZYZ"),
    "xyzwpr": lambda r: r.as_euler("ZYX")[:, ::-1],
    "rotvec": lambda r: r.as_rotvec(),
    "zyx": lambda r: r.as_euler("ZYX"),
}
USUAL = tuple(ORIENTATIONS)
OTHER_ORDERS = ("xyx", "xzx", "xzy", "yxy", "yxz", "yzx", "yzy", "zxy", "zxz")
ORIENTATIONS |= {order: lambda r, order=order: r.as_euler(order.upper()) for order in OTHER_ORDERS}
