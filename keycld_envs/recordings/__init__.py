"""Recordings and data sets in the format `keycld.recording/1`."""

from keycld_envs.recordings.dataset import Dataset, Sequences, read_dataset
from keycld_envs.recordings.recording import InvalidRecording, Recording
from keycld_envs.recordings.storage import SCHEMA, read_recording, write_recording

__all__ = [
    "SCHEMA",
    "Dataset",
    "InvalidRecording",
    "Recording",
    "Sequences",
    "read_dataset",
    "read_recording",
    "write_recording",
]
