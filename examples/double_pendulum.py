"""Two rods, one on the other: `keycld track VIDEO --mechanism examples/double_pendulum.py --marks ... --out REC`."""

from keycld_envs import Mechanism, Rod

mechanism = Mechanism(num_keypoints=2, num_actions=0, rods=(Rod(None, 0), Rod(0, 1)))
