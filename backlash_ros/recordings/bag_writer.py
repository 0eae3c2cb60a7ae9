"""A rosbag2 folder (mcap) that is complete after every save, not only after it is closed.

Readers of mcap look for a summary at the end of the file. In a single call, each save overwrites this summary with the
new messages and a new summary; then it replaces ``metadata.yaml`` by a complete new file. Between two saves, and after
a failed one, the folder is as if the recording had ended with the last save, whatever happens to the process.

If the process is killed during that call, the file has no end; ``read_bag`` and rosbag2 then scan it, and read it up to
the previous save.
"""

import json
import os
import struct
from binascii import crc32
from pathlib import Path
from shutil import rmtree
from types import MappingProxyType
from typing import Any, cast

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_mcap import McapWriter

_MESSAGE = 0x05
"""Opcode of a message record."""

_CHUNK_SIZE = 2**20
"""Size from which on a chunk is closed, bytes."""


class _Unsaved:
    """Bytes for position ``start`` of a file that are not written yet, with the methods of a file."""

    def __init__(self, start: int) -> None:
        self.start = start
        self.data = bytearray()

    def tell(self) -> int:
        return self.start + len(self.data)

    def write(self, data: bytes) -> int:
        self.data += data
        return len(data)

    def close(self) -> None:
        """Stay open: more follows after a summary."""


class _Storage(McapWriter):
    """An mcap file that can be closed again and again."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.bio.flush()
        self._file = self.bio
        self._unsaved = _Unsaved(self._file.tell())
        self._summary = b""
        self.bio = cast("Any", self._unsaved)

    def close_chunk(self) -> None:
        """Close the chunk with a checksum, which reveals a half-written one."""
        start = len(self._unsaved.data)
        checksum = crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        self._unsaved.data[start + 33 : start + 37] = checksum.to_bytes(4, "little")

    def write(
        self, connection: Connection, timestamp: int, data: bytes | memoryview, published: int | None = None
    ) -> None:
        """Write a message; ``published`` is its time of publication, by default ``timestamp``."""
        chunk, number = self.chunk, connection.id
        self.message_start_time = min(timestamp, self.message_start_time)
        self.message_end_time = max(timestamp, self.message_end_time)
        self.channel_stats[number] += 1
        chunk.message_start_time = min(timestamp, chunk.message_start_time)
        chunk.message_end_time = max(timestamp, chunk.message_end_time)
        chunk.msgs[number].append((timestamp, chunk.bio.tell()))
        head = struct.pack("<HIQQ", number, 0, timestamp, timestamp if published is None else published)
        chunk.bio.write(struct.pack("<BQ", _MESSAGE, len(head) + len(data)) + head)
        chunk.bio.write(data)
        if chunk.bio.tell() > _CHUNK_SIZE:
            self.close_chunk()

    def close(self, version: int, metadata: str) -> None:
        """Complete the file; on an error it stays as it was."""
        if self.chunk.bio.tell():
            self.close_chunk()
        size = len(self._unsaved.data)
        super().close(version, metadata)
        try:
            self._put(self._unsaved.data)
        except OSError:
            self._unsaved.data = self._unsaved.data[:size]
            self._put(self._summary)  # back to where it was: this takes no space
            raise
        self._summary = bytes(self._unsaved.data[size:])
        self._unsaved = _Unsaved(self._unsaved.start + size)
        self.bio = cast("Any", self._unsaved)

    def _put(self, data: bytes | bytearray) -> None:
        file, start, rest = self._file.fileno(), self._unsaved.start, memoryview(data)
        # Without the last byte of its summary the file cannot pass for whole meanwhile.
        os.ftruncate(file, max(start, os.fstat(file).st_size - 1))
        while rest:
            rest = rest[os.pwrite(file, rest, start + len(data) - len(rest)) :]
        os.ftruncate(file, start + len(data))


class BagWriter(Writer):
    """Writes a new rosbag2 folder; messages are safe after ``save`` or ``close``.

    ``saved``: number of safe messages by topic. Both methods raise OSError if something cannot be written; the folder
    is then as the last save left it, and the rest is kept for the next save. The first save creates the folder.
    ``ros_distro``: the name of the ROS distribution that the messages come from.
    """

    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: _Storage})

    def __init__(self, path: Path, ros_distro: str = "unknown") -> None:
        super().__init__(path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        self.saved: dict[str, int] = {}
        self._ros_distro = ros_distro
        self._spare = self.metapath.with_suffix(".yaml.tmp")
        try:
            self.open()
            self.save()
        except OSError:
            rmtree(path, ignore_errors=True)
            raise

    def write(
        self, connection: Connection, timestamp: int, data: bytes | memoryview, published: int | None = None
    ) -> None:
        """Write a message received at ``timestamp`` and ``published`` before, if known, ns since the epoch."""
        assert isinstance(self.storage, _Storage)
        self.storage.write(connection, timestamp, data, published)
        self.counts[connection.id] += 1
        self.min_timestamp = min(timestamp, self.min_timestamp)
        self.max_timestamp = max(timestamp, self.max_timestamp)

    def save(self) -> None:
        """Complete the folder, and go on."""
        assert self.storage
        if self.metapath.exists() and self._written() == self.saved:
            return
        metadata = self._metadata()
        try:
            # First what takes space beside the messages: if it cannot be had, they are not counted as saved either.
            self._spare.write_text(json.dumps({"rosbag2_bagfile_information": metadata}, indent=1), "utf8")
            self.storage.close(self.version, json.dumps(metadata))
            self.saved = self._written()
            self._spare.replace(self.metapath)
        finally:
            self._spare.unlink(missing_ok=True)

    def close(self) -> None:
        """Complete the folder, and end."""
        self.save()
        self.storage = None

    def _written(self) -> dict[str, int]:
        return {connection.topic: self.counts[connection.id] for connection in self.connections}

    def _metadata(self) -> dict[str, Any]:
        """Return the content of ``metadata.yaml``, as JSON, which is valid YAML and fast to write."""
        start, count = self.min_timestamp, sum(self.counts.values())
        file = f"{self.path.name}.mcap"
        span = {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": max(0, self.max_timestamp - start)},
            "message_count": count,
        }
        topics = [
            {
                "topic_metadata": {
                    "name": connection.topic,
                    "type": connection.msgtype,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": dump_qos_v9(cast("Any", connection.ext).offered_qos_profiles),
                    "type_description_hash": connection.digest,
                },
                "message_count": self.counts[connection.id],
            }
            for connection in self.connections
        ]
        return {
            "version": self.version,
            "storage_identifier": "mcap",
            "relative_file_paths": [file],
            **span,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": file, **span}],
            "custom_data": None,
            "ros_distro": self._ros_distro,
        }
