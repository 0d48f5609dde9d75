"""The corrected joint model."""

from dataclasses import replace
from pathlib import Path

from keycld_envs.effects import Effect
from keycld_envs.errors import InputError
from keycld_model.delan.correction import scaled, with_friction
from keycld_model.delan.model import JointModel
from keycld_model.delan.rig import common_factor, learned_dynamics
from keycld_model.diagnosis.verdict.evidence import Evidence


def corrected_joint_model(evidence: Evidence) -> tuple[JointModel, list[Effect]]:
    """The joint model that was diagnosed, with its masses refitted and the friction that it lacks.

    Returns:
        The model, and effects that no joint model has; they are in the report alone.

    Raises:
        InputError: if it was no joint model that was diagnosed.
    """
    learned = learned_dynamics(evidence.nominal)
    if learned is None:
        raise InputError("The simulator that was diagnosed is no joint model; write_corrected writes its MJCF.")
    factor = common_factor(evidence.refitted)
    model, left = with_friction(scaled(learned.model, factor), evidence.effects)
    added = [str(effect) for effect in evidence.effects if effect not in left]
    return replace(model, meta={"corrected": {"factor_of_masses": factor, "added": added}}), left


def write_corrected_joint_model(evidence: Evidence, path: Path) -> list[Effect]:
    """Write a checkpoint folder of the corrected joint model; returns effects that it does not have."""
    model, left = corrected_joint_model(evidence)
    model.save(path)
    return left
