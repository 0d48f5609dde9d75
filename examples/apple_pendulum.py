"""A bob on a string that swings freely: `keycld track VIDEO --mechanism examples/apple_pendulum.py --out REC`."""

from keycld_envs import Mechanism, Rod

mechanism = Mechanism(num_keypoints=1, num_actions=0, rods=(Rod(None, 0),))
