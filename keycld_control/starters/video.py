"""A mechanism in videos and recordings of your own, without any simulation.

keycld track swing.mov --mechanism my_arm.py --out data/swing       # follow it in one video
keycld check my_arm.py --data data/my_arm                           # are recordings good to learn from?
keycld train my_arm.py --data data/my_arm --out runs/my_arm         # learn it from recordings with frames
"""

from keycld_envs import Mechanism, Rod

# Points that move, and what holds them at constant distances, as the camera sees them from in front. A rod from None
# starts at the pivot: where it is fixed, in image units ((0, 0) is the middle, 1 the right or upper border). A keypoint
# on a straight rail through the pivot is a Slider(keypoint, normal=(0.0, 1.0)), the normal at right angles to the rail.
# num_actions is the number of actuators in the recordings, 0 for what swings freely.
mechanism = Mechanism(num_keypoints=1, num_actions=0, rods=(Rod(None, 0),), pivot=(0.0, 0.0))
