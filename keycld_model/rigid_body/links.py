"""Which bodies of a model move as one."""

import mujoco


def rigid(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and what is fixed to it."""
    out = [body]
    for child in range(body + 1, model.nbody):
        if model.body_parentid[child] in out and not model.body_dofnum[child]:
            out.append(child)
    return out
