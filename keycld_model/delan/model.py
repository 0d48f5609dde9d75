"""`JointModel`: the learned dynamics of joints, ready to use."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from keycld_envs.effects import Effect
from keycld_envs.errors import InputError
from keycld_model.checkpoint import read_checkpoint, write_checkpoint
from keycld_model.delan.config import JointConfig
from keycld_model.delan.families import JointDynamics
from keycld_model.delan.friction import effects, friction_torque
from keycld_model.delan.network import Parameters
from keycld_model.numerics import rk4_step

Floats = NDArray[np.float64]
SUBSTEPS = 20
"""Runge-Kutta steps between two torques of a rollout, as many as the reference takes."""


@dataclass(frozen=True)
class Decomposition:
    """What the torques of motors do, each `[..., n]`, N m or N.

    Their sum is `JointModel.inverse_dynamics` where kinetic energy is quadratic in velocities: not in black boxes.

    Attributes:
        inertial: f(q, 0, a) - f(q, 0, 0), where f is the inverse dynamics.
        coriolis: f(q, v, 0) - f(q, 0, 0), Coriolis and centrifugal, without friction.
        gravity: f(q, 0, 0), and springs.
        friction: against friction.
    """

    inertial: Floats
    coriolis: Floats
    gravity: Floats
    friction: Floats


@dataclass(frozen=True, eq=False)
class JointModel:
    """Learned dynamics of n joints: torques, accelerations, inertias, energies.

    Positions are in rad (hinges) or m (slides), velocities and accelerations in their units per second, torques in N m
    or N. All methods take one sample `[n]` or many `[..., n]`, and refuse other shapes and numbers that are not finite.

    Attributes:
        config: family and joints.
        parameters: nested dictionary of arrays.
        meta: what the checkpoint says about its training.
    """

    config: JointConfig
    parameters: Parameters
    meta: dict[str, Any] | None = None

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "JointModel":
        """Read a checkpoint folder that `keycld delan train` or `save` wrote.

        Raises:
            InputError: if there is none, or it is damaged or of another kind.
        """
        tensors, meta = read_checkpoint(path)
        if "joint_model" not in meta or "model" not in tensors:
            raise InputError(f"{path} is not a joint model; name a folder that `keycld delan train` wrote.")
        config = JointConfig.from_dict(meta["joint_model"])
        parameters = {"equations": {}, "friction": {}} | tensors["model"]
        expected = JointDynamics(config).initial(0)
        found, asked = (jax.tree.map(np.shape, tree) for tree in (parameters, expected))
        if found != asked:
            raise InputError(f"{path} does not hold the arrays that its own configuration asks for; train again.")
        return cls(config, parameters, meta)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a checkpoint folder; a kill leaves the old one or the new one."""
        meta = {k: v for k, v in (self.meta or {}).items() if k not in ("schema", "sha256", "versions")}
        return write_checkpoint(path, {"model": self.parameters}, meta | {"joint_model": self.config.to_dict()})

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Floats:
        """Torques of motors `[..., n]` that accelerate by a in the state q, v."""
        return self._call("inverse_dynamics", q=q, v=v, a=a)

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Floats:
        """Accelerations `[..., n]` under torques of motors tau in the state q, v."""
        return self._call("forward_dynamics", q=q, v=v, tau=tau)

    def mass_matrix(self, q: ArrayLike) -> Floats:
        """Inertias `[..., n, n]`; of a feed-forward network, how its torques at rest change with accelerations."""
        return self._call("mass_matrix", q=q)

    def potential_energy(self, q: ArrayLike) -> Floats:
        """`[...]`, J, zero where all positions are zero.

        Raises:
            InputError: also if the model is a feed-forward network, which has none.
        """
        self._check_energies()
        return self._call("potential_energy", q=q)

    def energy(self, q: ArrayLike, v: ArrayLike) -> Floats:
        """Kinetic and potential energy `[...]`, J; see `potential_energy`."""
        self._check_energies()
        return self._call("energy", q=q, v=v)

    def power(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Floats:
        """Power `[...]` that motors give, W: into the model's energy and friction; of a network without, tau v."""
        return self._call("power", q=q, v=v, a=a)

    def decompose(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Decomposition:
        """The torques of `inverse_dynamics` by what they do."""
        return Decomposition(*np.moveaxis(self._call("decompose", q=q, v=v, a=a), -2, 0))

    def rollout(
        self,
        q: ArrayLike,
        v: ArrayLike,
        tau: ArrayLike,
        timestep: float,
        hold: Literal["held", "linear"] = "held",
        substeps: int = SUBSTEPS,
    ) -> tuple[Floats, Floats]:
        """Follow the motion from a state, by Runge-Kutta steps of fourth order.

        Args:
            q: `[n]` first positions.
            v: `[n]` first velocities.
            tau: `[T, n]` torques at the times of what is returned; the last one does nothing.
            timestep: seconds between them.
            hold: torques stay as they are until the next ("held"), or go there along a line ("linear").
            substeps: steps between two torques.

        Returns:
            Positions and velocities, `[T, n]` each; not finite where the model's motion runs away.
        """
        state = self._checked({"q": q, "v": v}, one=True)
        torques = self._checked({"tau": tau}, dimensions=2)[0]
        if not (np.isfinite(timestep) and timestep > 0 and substeps >= 1 and hold in ("held", "linear")):
            raise InputError("timestep must be a positive number, substeps 1 or more, and hold 'held' or 'linear'.")
        rest = (1 << (len(torques) - 1).bit_length()) - len(torques) + 1  # few lengths: few programs are compiled
        torques = np.pad(torques, ((0, rest), (0, 0)), mode="edge")
        ends = torques[:-1], torques[1:] if hold == "linear" else torques[:-1]
        with jax.enable_x64(True):
            path = self._rollout(*state, *ends, timestep, substeps)
        first = len(torques) - rest - 1
        positions, velocities = (
            np.concatenate([x[None], np.asarray(y)[:first]]) for x, y in zip(state, path, strict=True)
        )
        return positions, velocities

    @property
    def conserves(self) -> bool:
        """Whether it has energies, which only motors and friction change: all but feed-forward networks."""
        return self._dynamics.equations.conserves

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The learned friction as effects at the joints, for simulators and the diagnosis."""
        return effects(self.config, self.parameters["friction"])

    @cached_property
    def _dynamics(self) -> JointDynamics:
        return JointDynamics(self.config)

    @cached_property
    def _compiled(self) -> dict[str, tuple[Callable[..., Array], Callable[..., Array]]]:
        """Each function for one sample, and for many; its arguments come in one array `[k, n]`."""
        dynamics, p = self._dynamics, self.parameters
        with jax.enable_x64(True):
            p = jax.tree.map(jnp.asarray, p)
        equations, pe = dynamics.equations, p["equations"]

        def decompose(q: Array, v: Array, a: Array) -> Array:
            zero, f = jnp.zeros_like(q), equations.inverse_dynamics
            gravity = f(pe, q, zero, zero)
            inertial, coriolis = f(pe, q, zero, a) - gravity, f(pe, q, v, zero) - gravity
            return jnp.stack([inertial, coriolis, gravity, friction_torque(p["friction"], v)])

        def potential(q: Array) -> Array:
            return equations.potential_energy(pe, q) - equations.potential_energy(pe, jnp.zeros_like(q))

        def energy(q: Array, v: Array) -> Array:
            return equations.energy(pe, q, v) - equations.potential_energy(pe, jnp.zeros_like(q))

        def power(q: Array, v: Array, a: Array) -> Array:
            conserves = equations.conserves
            return dynamics.energy_rate(p, q, v, a) if conserves else v @ dynamics.inverse_dynamics(p, q, v, a)

        functions: dict[str, Callable[..., Array]] = {
            "inverse_dynamics": lambda q, v, a: dynamics.inverse_dynamics(p, q, v, a),
            "forward_dynamics": lambda q, v, tau: dynamics.forward_dynamics(p, q, v, tau),
            "mass_matrix": lambda q: equations.mass_matrix(pe, q),
            "potential_energy": potential,
            "energy": energy,
            "power": power,
            "decompose": decompose,
        }
        packed = {name: (lambda x, f=f: f(*x)) for name, f in functions.items()}
        return {name: (jax.jit(f), jax.jit(jax.vmap(f, in_axes=1))) for name, f in packed.items()}

    @cached_property
    def _rollout(self) -> Callable[..., Any]:
        dynamics, p = self._dynamics, self.parameters

        def interval(state: tuple[Array, Array], ends: tuple[Array, Array], h: Array, substeps: int) -> Any:
            def part(state: tuple[Array, Array], i: Array) -> tuple[tuple[Array, Array], None]:
                tau = ends[0] + (i + 0.5) / substeps * (ends[1] - ends[0])
                return rk4_step(lambda q, v: dynamics.forward_dynamics(p, q, v, tau), *state, h / substeps), None

            state, _ = jax.lax.scan(part, state, jnp.arange(substeps))
            return state, state

        def rollout(q: Array, v: Array, before: Array, after: Array, h: Array, substeps: int) -> tuple[Array, Array]:
            return jax.lax.scan(lambda s, ends: interval(s, ends, h, substeps), (q, v), (before, after))[1]

        return jax.jit(rollout, static_argnums=5)

    def _call(self, function: str, **arguments: ArrayLike) -> Floats:
        arrays = self._checked(arguments)
        single, many = self._compiled[function]
        with jax.enable_x64(True):
            if arrays.ndim == 2:
                return np.asarray(single(arrays))
            shape = arrays.shape[1:-1]
            out = np.asarray(many(arrays.reshape(len(arrays), -1, self.config.n)))
        return out.reshape(*shape, *out.shape[1:])

    def _checked(self, arguments: dict[str, ArrayLike], one: bool = False, dimensions: int | None = None) -> Floats:
        """All arguments in one array `[k, ..., n]`."""
        arrays = [np.asarray(value, np.float64) for value in arguments.values()]
        shape, n = arrays[0].shape, self.config.n
        wanted = 1 if one else dimensions
        for name, array in zip(arguments, arrays, strict=True):
            if array.shape != shape or not shape or shape[-1] != n or wanted not in (None, len(shape)):
                first = next(iter(arguments))
                asked = {1: f"[{n}]", 2: f"[T, {n}]", None: f"[..., {n}]"}[wanted]
                raise InputError(
                    f"{name} has shape {list(array.shape)}; this model of {n} joint(s) needs {asked}"
                    + ("." if name == first else f", the same as {first}.")
                )
        whole = np.stack(arrays)
        if not np.isfinite(whole).all():
            name = next(n for n, array in zip(arguments, arrays, strict=True) if not np.isfinite(array).all())
            raise InputError(f"{name} holds NaN or infinity; every number must be finite.")
        return whole

    def _check_energies(self) -> None:
        if not self.conserves:
            raise InputError("A model with a feed-forward network has no energy; train another family.")
