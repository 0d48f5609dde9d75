"""A pendulum that a motor drives: `keycld track VIDEO --mechanism examples/motor_pendulum.py --out REC`."""

from keycld_envs import Mechanism, Rod

mechanism = Mechanism(num_keypoints=1, num_actions=1, rods=(Rod(None, 0),))
