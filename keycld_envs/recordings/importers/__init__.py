"""Recordings from files of other programs: each importer reads a table, `assemble` makes a recording of it."""

from keycld_envs.recordings.importers.csv import read_csv
from keycld_envs.recordings.importers.data_set import open_data_set
from keycld_envs.recordings.importers.episode import Episode, expand_units
from keycld_envs.recordings.importers.epos import is_epos, read_epos
from keycld_envs.recordings.importers.json import read_json_log
from keycld_envs.recordings.importers.log import read_log
from keycld_envs.recordings.importers.mapping import Columns, assemble
from keycld_envs.recordings.importers.mat import read_mat
from keycld_envs.recordings.importers.mcap import read_mcap
from keycld_envs.recordings.importers.table import Table

__all__ = [
    "Columns",
    "Episode",
    "Table",
    "assemble",
    "expand_units",
    "is_epos",
    "open_data_set",
    "read_csv",
    "read_epos",
    "read_json_log",
    "read_log",
    "read_mat",
    "read_mcap",
]
