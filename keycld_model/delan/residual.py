"""A joint model of what another one leaves in the torques of new logs, added to it."""

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np

from keycld_envs.errors import InputError
from keycld_model.checkpoint import flatten
from keycld_model.delan.config import FRICTIONS, JointConfig, Scales
from keycld_model.delan.model import JointModel
from keycld_model.delan.motions import Motions
from keycld_model.delan.network import Parameters
from keycld_model.delan.sum import part_name

ROUNDING = 1e-6
"""Share of the torques' spread below which what a model leaves in them is rounding."""


@dataclass(frozen=True)
class Residual:
    """A frozen joint model and one that is added to it: torques, inertias, energies and friction of both.

    Attributes:
        base: the frozen model; it may be a sum itself.
        own: what is learned, with the usual size of the torques that are left.
        scales: usual sizes of all signals.
    """

    base: JointModel
    own: JointConfig
    scales: Scales

    @cached_property
    def config(self) -> JointConfig:
        """Of base and residual together.

        Raises:
            InputError: if both have Stribeck friction, whose sum is none.
        """
        base, own = self.base.config, self.own
        if "stribeck_friction" in set(base.friction) & set(own.friction):
            raise InputError(
                "friction names stribeck_friction, which the base has already, and two of them are none; name "
                "coulomb_friction or viscous_friction."
            )
        friction = {*base.friction, *own.friction}
        if "stribeck_friction" in friction:
            friction -= {"coulomb_friction"}  # which it takes up
        parts = tuple(replace(part, friction=()) for part in (*(base.parts or (base,)), own))
        kinds = tuple(id for id in FRICTIONS if id in friction)
        return JointConfig(own.joints, own.kinds, self.scales, "sum", friction=kinds, parts=parts)

    @cached_property
    def base_sha256(self) -> str:
        """Hash of the base."""
        digest = hashlib.sha256(json.dumps(self.base.config.to_dict(), sort_keys=True).encode())
        for name, array in sorted(flatten(self.base.parameters).items()):
            digest.update(name.encode() + np.ascontiguousarray(array, np.float64).tobytes())
        return digest.hexdigest()

    def parameters(self, own: Parameters) -> Parameters:
        """Of base and residual together, to be traced."""
        equations, last = self.base.parameters["equations"], len(self.config.parts) - 1
        parts = equations if self.base.config.parts else {part_name(0): equations}
        friction = _joined(self.base.parameters["friction"], own["friction"])
        return {"equations": {**parts, part_name(last): own["equations"]}, "friction": friction}


def what_is_left(base: JointModel, motions: Motions) -> Motions:
    """Motions with the torques that a model leaves.

    Raises:
        InputError: if the model is of other joints, has a feed-forward network, or leaves nothing.
    """
    config, source = base.config, motions.source
    if not base.conserves:
        raise InputError("The base has a feed-forward network, which nothing can be added to; name another model.")
    if (config.joints, config.kinds) != (motions.joints, motions.kinds):
        ours, theirs = (", ".join(map(" ".join, zip(x.kinds, x.joints, strict=True))) for x in (motions, config))
        raise InputError(f"{source} has the joints {ours}; the base has {theirs}: name data of the base's own joints.")
    left = tuple(replace(m, tau=m.tau - base.inverse_dynamics(m.q, m.v, m.a)) for m in motions.motions)
    rest = replace(motions, motions=left)
    if (rest.all("tau").std(axis=0) <= ROUNDING * motions.all("tau").std(axis=0).max()).all():
        raise InputError(f"The base explains the torques of {source} to rounding; no residual is left to learn.")
    return rest


def _joined(base: Parameters, own: Parameters) -> Parameters:
    """Friction of both, as logarithms of parameters; Stribeck friction takes up Coulomb friction."""
    both = {id: dict(values) for id, values in base.items()}
    for id, values in own.items():
        mine = both.setdefault(id, {})
        both[id] = mine | {n: jnp.logaddexp(mine[n], value) if n in mine else value for n, value in values.items()}
    if "stribeck_friction" in both and "coulomb_friction" in both:
        sliding, fading = both.pop("coulomb_friction")["c"], both["stribeck_friction"]
        fading["c"] = jnp.logaddexp(fading["c"], sliding)
    return both
