"""A multilayer perceptron with continuously differentiable activations (KeyCLD paper, appendix A.4)."""

from flax import nnx
from jax import Array


class MLP(nnx.Module):
    """Two hidden layers with CELU.

    Args:
        inputs: size of the input.
        hidden: width of both hidden layers.
        outputs: size of the output.
        output_scale: factor on the output, to bring it to the order of the quantity that it stands for.
        kernel_scale: standard deviation of all initial weights (the paper: 0.01); None scales them with the width.
        rngs: initialisation.
    """

    def __init__(
        self, inputs: int, hidden: int, outputs: int, output_scale: float, kernel_scale: float | None, rngs: nnx.Rngs
    ) -> None:
        self.output_scale = output_scale
        normal = nnx.initializers.normal
        init = nnx.initializers.lecun_normal() if kernel_scale is None else normal(kernel_scale)
        self.first = nnx.Linear(inputs, hidden, kernel_init=init, rngs=rngs)
        self.second = nnx.Linear(hidden, hidden, kernel_init=init, rngs=rngs)
        self.out = nnx.Linear(hidden, outputs, kernel_init=normal(kernel_scale or 0.01), rngs=rngs)

    def __call__(self, x: Array) -> Array:
        """`[inputs]` to `[outputs]`."""
        return self.output_scale * self.out(nnx.celu(self.second(nnx.celu(self.first(x)))))
