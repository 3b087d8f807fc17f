"""The package vision-calibration (pip install vision-calibration): camera, hand-eye and board in one adjustment."""

from __future__ import annotations

from typing import Any

import numpy as np
import vision_calibration as peer
from scipy.spatial.transform import Rotation

from benchmarks.board_views import View, pose_of, read_views
from benchmarks.entries.opencv import Rig, points_on_sheet
from benchmarks.tracks.hand_eye import NAMES, values_of


def _posed(view: View) -> Any:
    quaternion = Rotation.from_matrix(view.flange[:3, :3]).as_quat()
    return peer.Pose(tuple(quaternion.tolist()), tuple(view.flange[:3, 3].tolist()))


def _pose(one: Any) -> Any:
    return pose_of(Rotation.from_quat(one.rotation_xyzw), one.translation_xyz)


def _solved(views: list[View]) -> Any:
    """``run_single_cam_handeye`` with its defaults."""
    seen = [
        peer.SingleCamHandeyeView(
            peer.Observation([tuple(p) for p in view.points.tolist()], [tuple(p) for p in view.pixels.tolist()]),
            _posed(view),
        )
        for view in views
    ]
    return peer.run_single_cam_handeye(peer.SingleCamHandeyeDataset(seen), peer.SingleCamHandeyeCalibrationConfig())


def hand_eye(case: dict[str, Any]) -> dict[str, Any]:
    """Poses of the adjustment."""
    found = _solved(read_views(case))
    return {"name": NAMES, "value": values_of([_pose(found.gripper_se3_camera), _pose(found.base_se3_target)])}


def sensor(case: dict[str, Any]) -> dict[str, Any]:
    """Its camera and boards, and a plane through the stripes: its own laser calibration knows no robot."""
    views = read_views(case)
    found = _solved(views)
    k, d = found.camera.intrinsics, found.camera.distortion
    matrix = np.array([[k.fx, 0.0, k.cx], [0.0, k.fy, k.cy], [0.0, 0.0, 1.0]])
    flange = np.stack([view.flange for view in views])
    boards = np.linalg.inv(flange @ _pose(found.gripper_se3_camera)) @ _pose(found.base_se3_target)
    return points_on_sheet(case, views, Rig(matrix, np.array([d.k1, d.k2, d.p1, d.p2]), boards, flange))
