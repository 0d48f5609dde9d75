"""Recordings in the formats of other programs; what a format cannot hold is told."""

from keycld_envs.recordings.exporters.lerobot import write_lerobot
from keycld_envs.recordings.exporters.minari import write_minari
from keycld_envs.recordings.exporters.rerun import write_rerun

__all__ = ["write_lerobot", "write_minari", "write_rerun"]
