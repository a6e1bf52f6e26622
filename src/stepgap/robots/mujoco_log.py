"""Where MuJoCo reports that a simulation is unstable."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import mujoco


def leave_out_log_file() -> None:
    """Lets MuJoCo write no `MUJOCO_LOG.TXT` into the current folder, which it does by default.

    An unstable simulation gives a state that is not finite or too large, which the plants report as a failed step.
    """
    mujoco.set_mju_user_warning(lambda message: None)
