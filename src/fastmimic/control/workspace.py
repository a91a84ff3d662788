"""Work memory of the control law, so that it allocates nothing. Suffixes name the frame: _b body, _h heading."""

from typing import Final

from fastmimic.base.jit import record_dtype
from fastmimic.control.inertia import WORK as INERTIA_WORK

SCRATCH: Final = record_dtype(
    [
        ("rotation", "f8", (3, 3)),  # body → heading frame
        ("reference_rotation", "f8", (3, 3)),  # reference's body → robot's heading frame
        ("turn", "f8", (2,)),  # cos and sin from the robot's heading to that of the reference's origin
        ("com", "f8", (3,)),  # body frame
        ("inertia", "f8", (3, 3)),  # heading frame
        ("inverse_inertia", "f8", (3, 3)),
        ("feet", "f8", (4, 3)),  # body frame
        ("arms", "f8", (4, 3)),  # feet from the CoM, heading frame
        # velocities and accelerations of the base and of the reference, heading frame
        ("lin_vel", "f8", (3,)),
        ("ang_vel", "f8", (3,)),
        ("ref_lin_vel", "f8", (3,)),
        ("ref_ang_vel", "f8", (3,)),
        ("ref_lin_acc", "f8", (3,)),
        ("ref_ang_acc", "f8", (3,)),
        ("leg_acc", "f8", (3,)),  # that the reference's legs take
        # reference minus robot, heading frame
        ("error", "f8", (3,)),  # of the position; x and y then relative to the feet
        ("angle_error", "f8", (3,)),
        ("lin_vel_error", "f8", (3,)),
        ("ang_vel_error", "f8", (3,)),
        ("shift", "f8", (2,)),  # of the reference to where the standing feet are
        # the same in the body frame, for the legs
        ("position_error", "f8", (3,)),
        ("velocity_error", "f8", (3,)),
        ("lin_vel_b", "f8", (3,)),
        ("ang_vel_b", "f8", (3,)),
        ("ref_lin_vel_b", "f8", (3,)),  # in the reference's own body frame
        ("ref_ang_vel_b", "f8", (3,)),
        # stance
        ("desired", "f8", (6,)),  # acceleration that the forces have to give, heading frame
        ("columns", "f8", (12, 6)),
        ("gravity_acc", "f8", (3,)),  # desired linear acceleration minus gravity, heading frame
        ("gravity_acc_b", "f8", (3,)),
        # turning over the standing feet: angular acceleration beyond the reference's, and its moment
        ("beyond", "f8", (3,)),
        ("beyond_b", "f8", (3,)),
        ("moment", "f8", (3,)),
        ("moment_b", "f8", (3,)),
        ("held_inertia", "f8", (3, 3)),  # of the trunk with the standing feet held, body frame
        ("held", INERTIA_WORK),
        # legs
        ("jacobian", "f8", (3, 3)),
        ("force_b", "f8", (3,)),
        ("foot_target", "f8", (3,)),  # body frame
        ("joint_acc", "f8", (12,)),
        ("torque", "f8", (3,)),
        ("recovering", "f8"),  # 1 after a push, else 0
    ]
)  # one record per thread
