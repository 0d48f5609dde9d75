"""What every stage of training is."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import optax
from jax import Array

from keycld_model.modules import Parameters, Parts
from keycld_model.training.data import TrainingData

Variables = dict[str, Any]
"""Model parameters ("estimator", "renderer", "dynamics", "appearance") and what only training needs ("trajectories",
"aligned", "spread", "offsets", "trust", "rod_scale", "lean")."""
Batch = dict[str, Any]
Context = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Stage(ABC):
    """A number of optimiser steps on one loss over some of the variables.

    Everything random comes from the generator handed in, and `prepare` reads only what the stage does not train, so
    that an interrupted stage continues exactly where it stopped.

    Attributes:
        name: for the log.
        steps: optimiser steps.
        learning_rate: peak of a one-cycle schedule, or constant if `one_cycle` is off.
        batch: sequences or frames per step.
        one_cycle: warm up and anneal to zero.
        clip: bound on the norm of the gradient; None leaves it alone.
        trained: the variables this stage changes.
        forgetful: forget the optimiser's moments after every step, as every public version of the reference's code
            does: of Adam, sign descent remains. For a measured comparison only.
    """

    name: str
    steps: int
    learning_rate: float
    batch: int
    one_cycle: bool = True
    clip: float | None = 5.0
    trained: tuple[str, ...] = ()
    forgetful: bool = False
    optional: ClassVar[bool] = False

    def optimiser(self) -> optax.GradientTransformation:
        """Adam with this stage's schedule and clipping."""
        rate = self.learning_rate
        if self.one_cycle and self.steps > 1:
            warm_up = max(0.15, 1.001 / self.steps)  # one step at least; of none, the schedule makes NaN
            rate = optax.cosine_onecycle_schedule(self.steps, self.learning_rate, pct_start=warm_up)
        adam = forgetful(optax.adam(rate)) if self.forgetful else optax.adam(rate)
        return adam if self.clip is None else optax.chain(optax.clip_by_global_norm(self.clip), adam)

    def needed(self, parts: Parts, variables: Variables, data: TrainingData) -> bool:
        """Whether there is anything to do, given what earlier stages left; if not, the stage is left out.

        Batches of later stages are the same with and without a stage that is `optional`.
        """
        return True

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Variables to start from, given what earlier stages left."""
        return variables

    def prepare(self, parts: Parts, variables: Variables, data: TrainingData) -> Context:
        """Arrays that stay fixed during the stage, from variables that it does not train."""
        return {}

    @abstractmethod
    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """The next batch."""

    @abstractmethod
    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Scalar loss and what to log. Pure."""

    def leave(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Variables for later stages."""
        return variables


def forgetful(optimiser: optax.GradientTransformation) -> optax.GradientTransformation:
    """An optimiser whose state is never stored, so that each step is its first."""

    def update(updates: Any, state: Any, params: Any = None) -> tuple[Any, Any]:
        return optimiser.update(updates, state, params)[0], state

    return optax.GradientTransformation(optimiser.init, update)


def model_parameters(variables: Variables) -> Parameters:
    """The part of the variables that a world model consists of."""
    names = ("estimator", "renderer", "dynamics", "appearance")
    return {name: variables[name] for name in names if name in variables}
