"""The machines of the cell in millimetres: arm links in their Denavit-Hartenberg frames, table, sensor housing.

The shapes follow from where the joint axes lie. In the frame of link i its own next axis is z; the axis about which
the link itself turns is where the table of the arm puts it:

====  ================================  =======================================
link  turns about                       carries
====  ================================  =======================================
1     x = -75, parallel to -y           shoulder axis: z
2     x = -270, parallel to z           elbow axis: z
3     x = +90, parallel to y            forearm axis: z
4     x = 0, parallel to -y             wrist axis: z, 295 mm below the elbow's y
5     x = 0, parallel to y              flange axis: z
6     z                                 flange face at z = 0
====  ================================  =======================================

The upper arm lies beside the plane of the forearm (z = 50 ... 104 in frame 2), so that the elbow can fold past it.
"""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold
from shapes import block, cone, drum, hull, ring_of, union

# Link 1 is drawn standing upright with the base axis as z and the shoulder at this place, then brought into its frame.
_SHOULDER = (75.0, 0.0, 335.0)


def base() -> Manifold:
    """Foot, column and connector box, in the base frame; turned about z by joint 1."""
    plate = block((-105, -105, 0), (105, 105, 18), corner=22, chamfer=2)
    column = union([cone(92, 80, 10, 70), drum(80, 60, 176, chamfer=4)])
    box = block((-168, -58, 8), (-60, 58, 112), corner=12, chamfer=5)
    fins = [block((-176, y - 3, 30), (-160, y + 3, 90), chamfer=1) for y in (-40.0, -20.0, 0.0, 20.0, 40.0)]
    bolts = ring_of(drum(8, 14, 26, at=(115, 0, 0), chamfer=1, segments=24), 4, start_deg=45)
    return union([plate, column, box, drum(84, 118, 130, chamfer=2), *fins, *bolts])


def link1() -> Manifold:
    """Turret and shoulder, with the motor of the upper arm behind."""
    x, _, z = _SHOULDER
    turret = union([drum(78, 173, 186, chamfer=1), drum(82, 182, 232, chamfer=6)])
    neck = hull(
        drum(66, 205, 230, chamfer=4),
        drum(66, -52, 40, axis="y", at=(x - 8, 0, z), chamfer=8),
        block((-62, -48, 215), (10, 44, 330), corner=20, chamfer=8),
    )
    housing = union(
        [
            drum(72, -58, 48, axis="y", at=(x, 0, z), chamfer=6),
            drum(58, 40, 54, axis="y", at=(x, 0, z), chamfer=1.5),
            drum(56, -88, -50, axis="y", at=(x, 0, z), chamfer=8),
            drum(40, -96, -80, axis="y", at=(x, 0, z), chamfer=4),
        ]
    )
    motor = hull(drum(34, 300, 392, at=(-24, -4, 0), chamfer=8), block((-52, -34, 290), (4, 26, 330), chamfer=4))
    upright = union([turret, neck, housing, motor])
    return upright.translate((-x, 0, -z)).rotate((90, 0, 0))  # frame 1: x ahead, y down, z along the shoulder axis


def link2() -> Manifold:
    """Upper arm beside the forearm's plane, a hub at both ends."""
    shoulder, elbow = (-270.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    arm = hull(drum(58, 56, 96, at=shoulder, chamfer=8), drum(44, 56, 92, at=elbow, chamfer=8))
    hubs = [
        drum(66, 52, 102, at=shoulder, chamfer=6),
        drum(48, 96, 114, at=shoulder, chamfer=5),
        drum(54, 52, 98, at=elbow, chamfer=6),
        drum(38, 92, 110, at=elbow, chamfer=5),
        drum(46, 47, 56, at=elbow, chamfer=1.5),
    ]
    rib = hull(drum(30, 90, 102, at=(-225, 0, 0), chamfer=4), drum(24, 88, 99, at=(-45, 0, 0), chamfer=4))
    bolts = [
        bolt.translate(centre)
        for centre, radius, top in ((shoulder, 56.0, 105.0), (elbow, 45.5, 101.0))
        for bolt in ring_of(drum(4, 90, top, at=(radius, 0, 0), chamfer=0.8, segments=16), 8, start_deg=22.5)
    ]
    return union([arm, *hubs, rib, *bolts])


def link3() -> Manifold:
    """Elbow hub about y at x = 90, and the root of the forearm about z."""
    hub = drum(56, -50, 48, axis="y", at=(90, 0, 0), chamfer=6)
    cover = drum(40, -60, -44, axis="y", at=(90, 0, 0), chamfer=5)
    root = drum(50, -62, 84, chamfer=8)
    bridge = hull(
        drum(44, -44, 42, axis="y", at=(86, 0, 0), chamfer=6), block((-30, -44, -52), (10, 42, 62), chamfer=6)
    )
    motor = drum(38, -96, -55, chamfer=6)
    collar = union([drum(46, 78, 96, chamfer=2), drum(52, 60, 74, chamfer=3)])
    cable = hull(drum(12, -70, -50, at=(0, -38, 0), chamfer=3), drum(12, -70, -50, at=(0, -52, 0), chamfer=3))
    return union([hub, cover, root, bridge, motor, collar, cable])


def link4() -> Manifold:
    """Forearm along y, ending in the fork of the wrist about z."""
    tube = hull(drum(47, 150, 201, axis="y", chamfer=3), drum(39, 78, 110, axis="y", chamfer=4))
    ring = drum(49, 186, 199, axis="y", chamfer=2)
    cheeks = [
        union([hull(drum(33, low, high, chamfer=3), block((-33, 70, low), (33, 96, high), chamfer=3)), cap])
        for low, high, cap in (
            (27.0, 43.0, drum(24, 40, 48, chamfer=2.5)),
            (-43.0, -27.0, drum(24, -48, -40, chamfer=2.5)),
        )
    ]
    return union([tube, ring, *cheeks])


def link5() -> Manifold:
    """Wrist between the cheeks of the fork: a hub about y, and the seat of the flange about z."""
    hub = union([drum(29, -24, 24, axis="y", chamfer=3), drum(16, -30, 30, axis="y", chamfer=1)])
    seat = hull(drum(24, 10, 50, chamfer=2), drum(22, -20, 20, axis="y", chamfer=2))
    return union([hub, seat, drum(24.5, 34, 53, chamfer=1.5)])


def link6() -> Manifold:
    """Flange after ISO 9409-1-40: face at z = 0, 50 mm across, four threads on a 40 mm circle."""
    body = union([drum(20, -29, -20, chamfer=1), drum(25, -24, 0, chamfer=1.5)])
    holes = ring_of(drum(3, -10, 1, at=(20, 0, 0), chamfer=0, segments=20), 4, start_deg=45)
    return body - union([*holes, drum(12.5, -6, 1, chamfer=0, segments=40)])


def platter() -> Manifold:
    """Rotary platter, top face at z = 0, a groove and degree marks in its rim."""
    plate = drum(120, -20, 0, chamfer=0, segments=240)
    groove = drum(124, -12.5, -9.5, chamfer=0, segments=240) - drum(117.5, -13, -9, chamfer=0, segments=240)
    marks = ring_of(block((118.8, -0.6, -7), (121, 0.6, -2)), 36)
    zero = block((118.8, -2, -8.5), (121, 2, -2))
    return plate - union([groove, *marks, zero])


def table_base() -> Manifold:
    """Fixed foot in the table frame: 1 mm of air under the platter, feet on the floor at z = -100."""
    drum_body = union([cone(98, 90, -88, -60), drum(90, -62, -28, chamfer=4), drum(60, -40, -21, chamfer=2)])
    plate = block((-100, -100, -100), (100, 100, -86), corner=18, chamfer=2)
    motor = union(
        [block((60, -42, -92), (150, 42, -32), corner=10, chamfer=4), drum(20, 140, 168, axis="x", at=(0, 0, -62))]
    )
    bolts = ring_of(drum(7, -90, -80, at=(112, 0, 0), chamfer=1, segments=24), 4, start_deg=45)
    return union([drum_body, plate, motor, *bolts])


def sensor_post() -> Manifold:
    """Post of a sensor whose mounting face is the plane x = 0 about the origin, on the floor at z = -400."""
    foot = block((-40, -100, -400), (160, 100, -384), corner=16, chamfer=2)
    column = block((14, -32, -390), (78, 32, 50), corner=8, chamfer=2)
    head = union([drum(31.5, 0, 10, axis="x", chamfer=1), block((8, -32, -40), (20, 32, 40), corner=4, chamfer=1)])
    bolts = [drum(7, -386, -376, at=(x, y, 0), chamfer=1, segments=24) for x in (-15, 135) for y in (-75, 75)]
    return union([foot, column, head, *bolts])


def chuck() -> Manifold:
    """Holder of a part on the flange, 40 mm high, in the flange frame."""
    return union(
        [
            drum(30, 0, 8, chamfer=1),
            cone(24, 14, 7, 16),
            drum(14, 10, 37, chamfer=0),
            cone(13, 17, 29, 37),
            drum(18, 35, 40, chamfer=1),
        ]
    )


def probe() -> Manifold:
    """Housing of the profile sensor in the sensor frame: laser slit at the origin, camera windows at x = ±60."""
    body = block((-80, -25, -70), (80, 25, -2), corner=6, chamfer=3)
    tilt = 29.3
    for side in (-1.0, 1.0):
        # A facet square to the camera's axis, and in it the recess of the window.
        facet = block((-24, -40, 0), (24, 40, 60)).rotate((0, -side * tilt, 0)).translate((side * 60, 0, -9))
        body -= facet
        recess = drum(15, -3, 20, chamfer=0, segments=48).rotate((0, -side * tilt, 0))
        body -= recess.translate((side * 60, 0, -9))
        lens = drum(9, -8, -1, chamfer=1, segments=40).rotate((0, -side * tilt, 0))
        body = body + lens.translate((side * 60, 0, -9))
    nose = hull(block((-16, -22, -20), (16, 22, -4), chamfer=1), block((-9, -18, -6), (9, 18, -2)))
    slit = block((-1.5, -12, -8), (1.5, 12, 1))
    fins = [block((x - 1.5, -23, -74), (x + 1.5, 23, -66)) for x in np.linspace(-72, -40, 6)]
    fins += [block((x - 1.5, -23, -74), (x + 1.5, 23, -66)) for x in np.linspace(40, 72, 6)]
    mount = union([drum(31.5, -80, -72, chamfer=1), hull(drum(27, -76, -72, chamfer=1), drum(22, -74, -66, chamfer=1))])
    plug = union([drum(8, -88, -60, at=(58, 0, 0), chamfer=1, segments=32), drum(5, -100, -80, at=(58, 0, 0))])
    return (union([body, nose, *fins, mount, plug])) - slit
