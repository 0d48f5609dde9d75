"""MCAP files, in which ROS 2 and other robots' programs log messages: each number in a message becomes a column."""

import os
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from keycld_envs.errors import InputError, reason
from keycld_envs.optional import optional
from keycld_envs.reading import check_file, check_size, parse_json
from keycld_envs.recordings.importers.json import numbers_in
from keycld_envs.recordings.importers.table import Table

NUMBER = 100
"""Bytes that a number takes in memory while a file is read."""
LONGEST = 1000
"""Entries; a longer list holds an image or a cloud of points, and is left out."""


def read_mcap(path: str | os.PathLike[str]) -> Table:
    """Read the numbers of all messages in JSON or in ROS 2's CDR encoding.

    A number `x` in messages of the topic `/joint_states` becomes the column "/joint_states.x", one inside another
    message "/joint_states.a.x", an entry of a list "/joint_states.x[0]". Where a message has a list `name` beside lists
    of the same length, as sensor_msgs/JointState, entries are called by it: "/joint_states.position.elbow".

    Each topic has two clocks, s since the earliest time in the file: "TOPIC.time", when it was measured, which is the
    `stamp` of the message's header or, where none is set, the time of publishing; and "TOPIC.log_time", when it was
    recorded. The rows of a topic are in the order of its "TOPIC.time".

    Args:
        path: the file.

    Returns:
        All columns; those of different topics have different lengths, and numbers that a message lacks are NaN.

    Raises:
        InputError: if the package mcap is missing, the file is missing, damaged or too large, or none of its messages
            can be decoded.
    """
    path = Path(path)
    reader = optional("mcap.reader", "mcap", "MCAP files")
    ros2 = optional("mcap_ros2.decoder", "mcap", "MCAP files").DecoderFactory()
    topics: dict[str, list[_Row]] = defaultdict(list)
    others: set[str] = set()
    size = 0
    try:
        for channel, message, content in _messages(path, reader, ros2):
            if content is None:
                others.add(f"{channel.topic} ({channel.message_encoding or 'no encoding'})")
            else:
                topics[channel.topic].append(row := _row(content, message))
                size += NUMBER * (1 + len(row[2]))
                check_size(size)
        return _table(path, topics, others)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; name an MCAP file.") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as MCAP ({reason(error)}); name a whole MCAP file.") from error


_Row = tuple[int, int, dict[str, float]]
"""Time of the measurement and of recording, ns, and the numbers of a message."""


def _messages(path: Path, reader: Any, ros2: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Channels, messages, and what `_decoded` makes of these.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is damaged.
    """
    with open(check_file(path, share=0), "rb") as file:  # of any size: messages are read one by one
        try:
            messages = reader.make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
            for schema, channel, message in messages:
                yield channel, message, _decoded(ros2, schema, channel, message)
        except Exception as error:  # of four packages, which raise anything where bytes are not what they expect
            raise ValueError(f"{type(error).__name__} {error}".strip()) from error


def _decoded(ros2: Any, schema: Any, channel: Any, message: Any) -> Any:
    """A message as objects, lists and numbers, or None if its encoding is neither JSON nor ROS 2's."""
    if channel.message_encoding == "json":
        return parse_json(message.data)
    if (decode := ros2.decoder_for(channel.message_encoding, schema)) is None:
        return None
    return _plain(decode(message.data))


def _plain(value: Any) -> Any:
    """A decoded ROS message as objects, lists and numbers."""
    if isinstance(value, int | float | str):
        return value
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value] if len(value) <= LONGEST else None
    if hasattr(value, "__slots__"):
        return {name: _plain(getattr(value, name)) for name in value.__slots__}
    return None  # bytes, as of images


def _row(content: Any, message: Any) -> _Row:
    stamp = _stamp(content) or message.publish_time or message.log_time
    return stamp, message.log_time, dict(numbers_in(_named(content)))


def _stamp(content: Any) -> int:
    """Time in the header of a message, ns; zero if there is none."""
    header = content.get("header") if isinstance(content, Mapping) else None
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if not isinstance(stamp, Mapping):
        return 0
    parts = [stamp.get("sec"), stamp.get("nanosec", stamp.get("nsec", 0))]
    return 10**9 * parts[0] + parts[1] if all(isinstance(part, int) for part in parts) else 0


def _named(content: Any) -> Any:
    """With the entries of lists called by the list `name` beside them, and without the header."""
    if not isinstance(content, Mapping):
        return content
    names = content.get("name")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        names = []
    out = {}
    for key, value in content.items():
        if names and isinstance(value, list) and len(value) == len(names) and key != "name":
            value = dict(zip(names, value, strict=True))
        if key != "header":
            out[key] = _named(value)
    return out


def _table(path: Path, topics: Mapping[str, list[_Row]], others: set[str]) -> Table:
    """Columns of all topics.

    Raises:
        ValueError: if there are none, or they would fill the memory, as those of topics with ever new names do.
    """
    if not topics:
        held = f"it holds only {', '.join(sorted(others))}" if others else "it holds no messages"
        raise ValueError(f"{held}; JSON and CDR messages of ROS 2 can be read")
    start = min(min(measured, logged) for rows in topics.values() for measured, logged, _ in rows)
    columns = {}
    for topic, unsorted in topics.items():
        rows = sorted(unsorted, key=lambda row: row[0])
        names = list(dict.fromkeys(name for *_, numbers in rows for name in numbers))
        check_size(8 * len(rows) * len(names))
        columns[f"{topic}.time"] = np.array([1e-9 * (measured - start) for measured, _, _ in rows])
        columns[f"{topic}.log_time"] = np.array([1e-9 * (logged - start) for _, logged, _ in rows])
        for name in names:
            column = f"{topic}.{name}" if name else topic
            columns.setdefault(column, np.array([numbers.get(name, np.nan) for *_, numbers in rows], float))
    return Table(path, columns)
