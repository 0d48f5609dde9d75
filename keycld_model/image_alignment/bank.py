"""Where a mechanism may be when nothing is known: drawings at many positions, to compare a frame with."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.scene import Scene, softened

Array = NDArray[np.float64]
Image = NDArray[np.float32]
POSITIONS = {1: 64, 2: 484}
"""Drawings for one joint and for two."""
MOST = 900
"""And for more."""
COARSE = 0.03
"""Standard deviation by which images are blurred before they are compared, of their height."""


class Bank:
    """Drawings of a scene at positions spread over all that its joints can reach.

    Attributes:
        q: `[M, nq]` positions.
        still: `[H, W, 3]` the median of all drawings, roughly what does not move.
    """

    def __init__(self, scene: Scene, look: Array) -> None:
        """Draw them."""
        low, high = scene.bounds()
        joints = len(low)
        if joints <= 2:
            side = round(POSITIONS[joints] ** (1 / joints))
            axes = [
                np.linspace(a, b, side, endpoint=False) + (b - a) / side / 2 for a, b in zip(low, high, strict=True)
            ]
            self.q = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, joints)
        else:
            points = qmc.Sobol(joints, scramble=False).random(1024)[:MOST]
            self.q = low + (high - low) * points
        images = np.stack([scene.render(q, look) for q in self.q])
        self.still: Image = np.median(images, axis=0).astype(np.float32)
        self._every = max(1, round(COARSE * scene.size[0]))
        self._drawn = np.stack([self._coarse(image) for image in images])

    def nearest(self, frame: Image, light: Light, number: int) -> Array:
        """Positions `[number, nq]` whose drawings are most like a frame, best first."""
        wanted = self._coarse(frame)
        left = np.minimum(np.abs(light.apply(self._drawn) - wanted), 60.0)
        return self.q[np.argsort(np.sum(left**2, axis=(1, 2, 3)))[:number]]

    def _coarse(self, image: Image) -> Image:
        return softened(image, COARSE * image.shape[0])[:: self._every, :: self._every]
