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
        linear: add a linear map of the input; it and the last layer then start at zero.
        rngs: initialisation.
    """

    def __init__(
        self,
        inputs: int,
        hidden: int,
        outputs: int,
        output_scale: float,
        kernel_scale: float | None,
        linear: bool,
        rngs: nnx.Rngs,
    ) -> None:
        self.output_scale = output_scale
        normal, zeros = nnx.initializers.normal, nnx.initializers.zeros
        init = nnx.initializers.lecun_normal() if kernel_scale is None else normal(kernel_scale)
        self.first = nnx.Linear(inputs, hidden, kernel_init=init, rngs=rngs)
        self.second = nnx.Linear(hidden, hidden, kernel_init=init, rngs=rngs)
        last = zeros if linear else normal(kernel_scale or 0.01)
        self.out = nnx.Linear(hidden, outputs, kernel_init=last, rngs=rngs)
        self.linear = nnx.Linear(inputs, outputs, kernel_init=zeros, rngs=rngs) if linear else None

    def __call__(self, x: Array) -> Array:
        """`[inputs]` to `[outputs]`."""
        y = self.out(nnx.celu(self.second(nnx.celu(self.first(x)))))
        return self.output_scale * (y if self.linear is None else y + self.linear(x))
