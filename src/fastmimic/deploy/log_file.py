"""Files of rows that are only appended to, so that what is written survives whatever ends the program.

They are MCAP (https://mcap.dev/spec) with ROS 2 messages, which Foxglove and ROS 2 read. A row is packed, its fields of
8 bytes first, then 4, then 1: so its bytes are its message in CDR.
"""

import json
import math
import mmap
import os
import shutil
import struct
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from fastmimic.base.arrays import Indices, Records
from fastmimic.base.errors import LogError, OutputError
from fastmimic.base.files import from_json
from fastmimic.base.text import plain

Kinds = Mapping[str, np.dtype[Any]]  # of rows, by topic
_TYPES: Final = {"f8": "float64", "i8": "int64", "i4": "int32", "i1": "int8", "b1": "bool"}
_CDR: Final = b"\x00\x01\x00\x00"  # plain, little-endian
_PER_ROW: Final = 64  # bytes of the file beside a row's own
_DAMAGED: Final = (
    *(McapError, OSError, ValueError, KeyError, struct.error, OverflowError),
    *(zstandard.ZstdError, RuntimeError),  # of a file that another program has compressed
)


def schema_of(kind: np.dtype[Any]) -> str:
    """The ROS 2 message definition of a row; a nested record is a message of the field's name."""
    lines, nested = [], ""
    for name in kind.names or ():
        inner = kind[name]
        if inner.names:
            lines.append(f"fastmimic/{name.capitalize()} {name}")
            nested += f"\n{'=' * 80}\nMSG: fastmimic/{name.capitalize()}\n{schema_of(inner)}"
        else:
            length = f"[{math.prod(inner.shape)}]" if inner.shape else ""
            lines.append(f"{_TYPES[inner.base.str[1:]]}{length} {name}")
    return "\n".join(lines) + nested


class LogFile:
    """A new file to append to; what was appended is on the disk. Its methods raise `OSError`."""

    def __init__(
        self,
        path: Path,
        kinds: Kinds,
        planned_rows: int,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        """`kinds` of rows by topic. Raises `OutputError` if there is such a file, it cannot be written, or the disk has
        no room for `planned_rows` of each topic."""
        self.path = path
        needed = planned_rows * sum(kind.itemsize + _PER_ROW for kind in kinds.values())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(path.parent).free
            if free < needed:
                said = f"the disk has {free / 1e6:.0f} MB free, and the log needs {needed / 1e6:.0f} MB"
                raise OutputError(f"{path}: {said}; make room, or choose another place")
            self._stream = open(path, "xb")  # noqa: SIM115
            try:
                self._begin(kinds, attachments or {}, metadata or {})
            except OSError:
                self.remove()
                raise
        except OSError as error:
            raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from None

    def _begin(self, kinds: Kinds, attachments: Mapping[str, bytes], metadata: Mapping[str, Any]) -> None:
        # a chunk ends where `add_rows` does
        writer = Writer(self._stream, sys.maxsize, CompressionType.NONE, enable_data_crcs=True)
        self._writer, self._channels, self._count = writer, dict[str, int](), 0
        writer.start(library="fastmimic")
        for topic, kind in kinds.items():
            name = f"fastmimic/msg/{topic.rpartition('/')[2].capitalize()}"
            schema = writer.register_schema(name, "ros2msg", schema_of(kind).encode())
            self._channels[topic] = writer.register_channel(topic, "cdr", schema)
        for name, content in attachments.items():
            writer.add_attachment(0, 0, name, "application/octet-stream", content)
        self._add_metadata("begin", metadata)
        self._sync()

    def add_rows(self, time_ns: Indices, rows: Mapping[str, Records]) -> None:
        """Appends (t,) rows of each topic at times since 1970, ns."""
        for topic, channel in self._channels.items():
            size, content = rows[topic].itemsize, rows[topic].tobytes()
            for i, time in enumerate(time_ns.tolist()):
                message = _CDR + content[i * size : (i + 1) * size]
                self._writer.add_message(channel, time, message, time, self._count + i)
        self._count += len(time_ns)
        self._writer.flush()
        self._sync()

    def end(self, metadata: Mapping[str, Any]) -> None:
        """Appends what is known in the end and an index, and closes the file."""
        self._add_metadata("end", metadata)
        self._writer.finish()
        self._sync()
        self._stream.close()

    def close(self) -> None:
        """Closes the file as it is."""
        with suppress(OSError):  # what the disk did not take
            self._stream.close()

    def remove(self) -> None:
        self.close()
        self.path.unlink(missing_ok=True)

    def _add_metadata(self, name: str, values: Mapping[str, Any]) -> None:
        texts = {key: json.dumps(plain(value), ensure_ascii=False) for key, value in values.items()}
        self._writer.add_metadata(f"fastmimic {name}", texts)

    def _sync(self) -> None:
        self._stream.flush()
        os.fsync(self._stream.fileno())


class LogContent(NamedTuple):
    """What a file holds."""

    rows: dict[str, Records]  # (t,) by topic
    attachments: dict[str, bytes]
    metadata: dict[str, Any]


def read_log_file(path: Path, kinds: Kinds) -> LogContent:
    """Reads the rows of these topics and everything else. A file that was not ended is read up to its last whole part.
    Raises `LogError` for no such file, a damaged one, or rows of another kind."""
    found, ended = LogContent({}, {}, {}), True
    rows = {topic: bytearray() for topic in kinds}
    schemas: dict[int, Schema] = {}
    topics: dict[int, str] = {}
    try:
        with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            ended = content[-len(MCAP0_MAGIC) :] == MCAP0_MAGIC and len(content) > len(MCAP0_MAGIC)
            stream: Any = content
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message):
                    topic = topics[record.channel_id]
                    if topic in kinds:
                        rows[topic].extend(record.data[len(_CDR) :])
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    topics[record.id], kind = record.topic, kinds.get(record.topic)
                    if kind is not None and schemas[record.schema_id].data != schema_of(kind).encode():
                        said = "rows of another version of FastMimic, which this one cannot read"
                        raise LogError(f"{path}: {said}")
                elif isinstance(record, Attachment):
                    found.attachments[record.name] = record.data
                elif isinstance(record, Metadata):
                    found.metadata.update({key: from_json(text) for key, text in record.metadata.items()})
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except _DAMAGED as error:
        if ended:
            raise LogError(f"{path}: the log is damaged ({error or 'it ends early'})") from None
    found.rows.update({topic: np.frombuffer(rows[topic], kind) for topic, kind in kinds.items()})
    return found
