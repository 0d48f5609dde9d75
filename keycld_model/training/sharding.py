"""Batches divided over all devices that JAX has, of this process or of several (JAX's own sharding)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

Tree = Any


class Devices:
    """All of them, in one row. With one device, everything stays as it is.

    Several processes form one row after `jax.distributed.initialize`. Each draws the same batches, and puts its part
    of them on its own devices; the loss, its gradient and the optimiser's step are those of the whole batch, up to the
    order of sums.
    """

    def __init__(self) -> None:
        self.number = jax.device_count()
        self.mesh: Mesh | None = None
        if self.number > 1:
            self.mesh = jax.make_mesh((self.number,), ("batch",), (AxisType.Auto,))

    @property
    def first(self) -> bool:
        """This process writes what all know."""
        return jax.process_index() == 0

    @property
    def everywhere(self) -> NamedSharding | None:
        """The same on all devices; None where there is one."""
        return None if self.mesh is None else NamedSharding(self.mesh, PartitionSpec())

    def replicate(self, tree: Tree) -> Tree:
        """Arrays, the same on all devices."""
        same = self.everywhere
        return tree if same is None else jax.tree.map(lambda a: _place(a, same), tree)

    def divide(self, batch: Tree) -> Tree:
        """Arrays, by their first dimension; those that do not divide evenly are the same on all devices."""
        same = self.everywhere
        if self.mesh is None or same is None:
            return batch
        parted = NamedSharding(self.mesh, PartitionSpec("batch"))
        even = all(np.ndim(a) and len(a) % self.number == 0 for a in jax.tree.leaves(batch))
        return jax.tree.map(lambda a: _place(a, parted if even else same), batch)

    def gather(self, tree: Tree) -> Tree:
        """Replicated arrays, on this process's own first device."""
        return tree if self.mesh is None else jax.tree.map(lambda a: jnp.asarray(np.asarray(a)), tree)


def _place(array: Any, sharding: NamedSharding) -> jax.Array:
    """Each process puts down what its own devices hold."""
    host = np.asarray(array)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])
