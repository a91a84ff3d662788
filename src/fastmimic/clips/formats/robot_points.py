"""The ten keypoints of a robot, for clips made from a robot's motion."""

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_rotate


def robot_points(root_pos_w: Array, root_quat_wxyz: Array, hip_pos_b: Array, foot_pos_b: Array) -> Array:
    """Keypoints (t, 10, 3) in the order of `POINT_NAMES`, world frame, m, for a base pose in the world, abduction joint
    origins (4, 3) and foot centres (t, 4, 3), body frame, m. Hips are the abduction joint origins; pelvis and neck are
    the midpoints of the rear and the front ones."""
    hips = np.broadcast_to(hip_pos_b, foot_pos_b.shape)
    pelvis, neck = hips[:, 2:].mean(axis=1, keepdims=True), hips[:, :2].mean(axis=1, keepdims=True)
    points_b = np.concatenate([pelvis, neck, hips, foot_pos_b], axis=1)
    return np.asarray(root_pos_w)[:, None] + quat_rotate(np.asarray(root_quat_wxyz)[:, None], points_b)
