"""Numbers that MuJoCo derives from others of a compiled model."""

import mujoco


def update_constants(model: mujoco.MjModel, data: mujoco.MjData | None = None) -> None:
    """Bring them up to date after masses, places or inertias have changed; the points that close loops stay.

    MuJoCo itself would move them, so that loops close at its reference position.
    """
    points = model.eq_data.copy()
    mujoco.mj_setConst(model, data or mujoco.MjData(model))
    model.eq_data[:] = points
