"""Joint models of any family, and the least squares of base parameters beside them."""

from pathlib import Path
from typing import Any

from keycld_model.delan import JointModel, Motions, train
from keycld_model.delan.baseline import fit_baseline


def trained(
    family: str, motions: Motions, folder: Path, seed: int, friction: tuple[str, ...] = ()
) -> tuple[JointModel, dict[str, Any]]:
    """A model, and how it was trained: seconds and iterations, None of least squares.

    Args:
        family: preset of `keycld_model.delan.presets`, or "least_squares".
        motions: to learn from.
        folder: of the model.
        seed: of the first weights and of the division.
        friction: ids of effects at every joint.
    """
    if family == "least_squares":
        model = fit_baseline(motions, friction)
        model.save(folder)
        return model, {"seconds": None, "iterations": None}
    result = train(motions, folder, family, friction, seed)
    return result.model, {"seconds": result.seconds, "iterations": result.iterations}
