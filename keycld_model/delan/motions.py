"""What joint models learn from: positions, velocities, accelerations and torques, one motion after another."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_model.delan.config import Kind, Scales

Floats = NDArray[np.float64]
CUTS = 10
"""Parts of equal length into which a single motion is cut, so that some can be held out."""
MOVES = 1e-9
"""rad or m, N m or N: signals that vary by less are constant."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One recording; all arrays but the clock are `[T, n]`.

    Attributes:
        id: its name, for instance a letter.
        t: `[T]`, s.
        q: positions, rad or m.
        v: velocities, per s.
        a: accelerations, per s^2.
        tau: torques of motors, N m or N.
        v_std: standard deviation of velocities that were estimated; zero of measured ones.
        a_std: the same of accelerations.
        truth: true parts of the torque by their name in `Decomposition`, where a simulation tells them.
    """

    id: str
    t: Floats
    q: Floats
    v: Floats
    a: Floats
    tau: Floats
    v_std: Floats
    a_std: Floats
    truth: dict[str, Floats] = field(default_factory=dict)

    def part(self, piece: slice | NDArray[np.intp], id: str) -> "Motion":
        """Some of its samples."""
        names = ("t", "q", "v", "a", "tau", "v_std", "a_std")
        arrays = {name: getattr(self, name)[piece] for name in names}
        return replace(self, id=id, **arrays, truth={name: x[piece] for name, x in self.truth.items()})


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of the same joints.

    Attributes:
        source: file or folder that they are from.
        joints: names, in the order of all arrays.
        kinds: "hinge" or "slide" of each.
        motions: at least one.
    """

    source: str
    joints: tuple[str, ...]
    kinds: tuple[Kind, ...]
    motions: tuple[Motion, ...]

    def __len__(self) -> int:
        return len(self.motions)

    @property
    def ids(self) -> tuple[str, ...]:
        """Names of the motions."""
        return tuple(motion.id for motion in self.motions)

    def all(self, name: str) -> Floats:
        """A signal of all motions, `[N, n]`."""
        return np.concatenate([getattr(motion, name) for motion in self.motions])

    def truth(self, name: str) -> Floats | None:
        """A true part of the torque of all motions, `[N, n]`, if it is known."""
        known = [motion.truth.get(name) for motion in self.motions]
        return np.concatenate([x for x in known if x is not None]) if all(x is not None for x in known) else None

    @cached_property
    def sha256(self) -> str:
        """Hash of joints and signals."""
        digest = hashlib.sha256(repr((self.joints, self.kinds)).encode())
        for motion in self.motions:
            digest.update(motion.id.encode())
            for name in ("t", "q", "v", "a", "tau"):
                digest.update(np.ascontiguousarray(getattr(motion, name)).tobytes())
        return digest.hexdigest()

    def hold_out(self, ids: Sequence[str]) -> tuple["Motions", "Motions"]:
        """Divide into the others and those of these names.

        Raises:
            InputError: if a name is unknown, or none is left.
        """
        held = self.chosen(ids)
        if len(held) == len(self):
            raise InputError(f"{self.source}: all motions are held out; leave some to learn from.")
        return self._chosen([id not in ids for id in self.ids]), held

    def chosen(self, ids: Sequence[str]) -> "Motions":
        """Those of these names.

        Raises:
            InputError: if a name is unknown, or there is none.
        """
        if unknown := [id for id in ids if id not in self.ids]:
            raise InputError(f"{self.source} has no motion {unknown[0]!r}; it has {', '.join(self.ids)}.")
        if not ids:
            raise InputError(f"{self.source}: no motion is named; it has {', '.join(self.ids)}.")
        return self._chosen([id in ids for id in self.ids])

    def split(self, validation: float, seed: int) -> tuple["Motions", "Motions"]:
        """Divide into motions to learn from and those that say when to stop, at random; a single one is cut first.

        Raises:
            InputError: if the fraction leaves none on one side.
        """
        whole = self if len(self) > 1 else self.cut()
        number = max(1, round(validation * len(whole)))
        if not 0 < validation < 1 or number >= len(whole):
            raise InputError(f"validation is {validation:g}; it must leave some of {len(whole)} motions on both sides.")
        held = set(np.random.default_rng(seed).permutation(len(whole))[:number].tolist())
        return whole._chosen([i not in held for i in range(len(whole))]), whole._chosen(
            [i in held for i in range(len(whole))]
        )

    def scales(self) -> Scales:
        """Usual sizes of the signals; a joint without a motor has the torque scale of the others.

        Raises:
            InputError: if a joint does not move, or no torque varies.
        """
        q, tau = self.all("q"), self.all("tau")
        for j, name in enumerate(self.joints):
            if np.ptp(q[:, j]) < MOVES:
                raise InputError(
                    f"{self.source}: joint {name!r} stays at {q[0, j]:g}; leave it out, or record its motion."
                )
        torque = tau.std(axis=0)
        if torque.max() < MOVES:
            raise InputError(f"{self.source}: the torques are constant; inertias need torques that vary.")
        torque = np.where(torque < MOVES, torque.max(), torque)
        sizes = (q.mean(axis=0), q.std(axis=0), self.all("v").std(axis=0), self.all("a").std(axis=0), torque)
        return Scales(*(tuple(map(float, size)) for size in sizes))

    def first(self, number: int) -> "Motions":
        """The first motions alone."""
        return replace(self, motions=self.motions[:number])

    def _chosen(self, chosen: Sequence[bool]) -> "Motions":
        return replace(self, motions=tuple(m for m, take in zip(self.motions, chosen, strict=True) if take))

    def cut(self, parts: int = CUTS) -> "Motions":
        """Each motion in parts of equal length.

        Raises:
            InputError: if a motion has fewer samples.
        """
        pieces = []
        for motion in self.motions:
            length = len(motion.t) // parts
            if not length:
                raise InputError(f"{self.source} holds {len(motion.t)} samples; {parts} are the least.")
            cuts = [slice(i * length, (i + 1) * length) for i in range(parts)]
            pieces += [motion.part(cut, f"{motion.id}/{i}") for i, cut in enumerate(cuts)]
        return replace(self, motions=tuple(pieces))

    def beginning(self, share: float) -> "Motions":
        """The first part of each motion, a share of its samples."""
        parts = [motion.part(slice(max(1, round(share * len(motion.t)))), motion.id) for motion in self.motions]
        return replace(self, motions=tuple(parts))
