"""The files of a rosbag2, finished or not: what of them can be read, and what is wrong with them."""

import os
import shutil
import sqlite3
import struct
from binascii import crc32
from collections.abc import Collection, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

_MAGIC = b"\x89MCAP0\r\n"
_HEADER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _ATTACHMENT, _METADATA = 1, 3, 4, 5, 6, 7, 9, 12
_DATA = {_HEADER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _ATTACHMENT, _METADATA}
"""Records that may precede the end of the data."""
_IN_CHUNK = {_SCHEMA, _CHANNEL, _MESSAGE}
_END = struct.pack("<BQL", 0x0F, 4, 0) + struct.pack("<BQQQL", 0x02, 20, 0, 0, 0) + _MAGIC  # of data, without a summary
_VALID_FOR = 92
"""Offset in a database's header of the number of the change for which its size is valid."""
_SIDE_FILES = "-wal", "-journal"
"""Endings of the files that sqlite keeps beside a database that was not closed."""


@dataclass(frozen=True)
class BagFiles:
    """What to read: the bag's folder or file, or the files in it; ``damage`` describes what is wrong."""

    paths: list[Path]
    damage: tuple[str, ...] = ()


def _is_torn_mcap(file: Path) -> bool:
    with file.open("rb") as stream:
        stream.seek(-min(len(_MAGIC), file.stat().st_size), os.SEEK_END)
        return stream.read() != _MAGIC


def _is_torn_database(file: Path) -> bool:
    """Return whether a database was not closed, or is shorter than its header says."""
    if any(Path(f"{file}{ending}").exists() for ending in _SIDE_FILES):
        return True
    with file.open("rb") as stream:
        head = stream.read(32)
    return len(head) < 32 or file.stat().st_size < _page(head) * int.from_bytes(head[28:32], "big")


def _page(head: bytes) -> int:
    """Return the size of a page of a database, by its header."""
    size = int.from_bytes(head[16:18], "big")
    return 65536 if size == 1 else size


def _whole_chunk(record: bytes) -> bool:
    """Return whether a chunk is intact; one that is compressed or has no checksum counts as intact."""
    if len(record) < 40:
        return False
    checksum, compression = struct.unpack_from("<LL", record, 24)
    return bool(checksum == 0 or compression > 0 or checksum == crc32(record[40:]))


def _begun(chunk: bytes) -> bytes:
    """Return the complete records at the beginning of a truncated chunk; none of a compressed one."""
    if len(chunk) < 40 or struct.unpack_from("<L", chunk, 28)[0] > 0:
        return b""
    end = 40
    while end + 9 <= len(chunk):
        kind, length = struct.unpack_from("<BQ", chunk, end)
        if kind not in _IN_CHUNK or end + 9 + length > len(chunk):
            break
        end += 9 + length
    return chunk[40:end]


def _is_overwritten(torn: Path) -> bool:
    """Return whether our own recorder was killed: it overwrites the previous summary, whose end is still there."""
    with torn.open("rb") as stream:
        stream.seek(-len(_MAGIC) + 1, os.SEEK_END)
        return stream.read() == _MAGIC[:-1]


def _mend_mcap(torn: Path, mended: Path, *, partly: bool) -> None:
    """Copy the intact part of an mcap file without end; ``partly``: with the complete records of its last chunk."""
    overwritten = _is_overwritten(torn)
    left = torn.stat().st_size - len(_MAGIC)
    with torn.open("rb") as source, mended.open("wb") as target:
        target.write(source.read(len(_MAGIC)))
        while len(head := source.read(9)) == 9:
            kind, length = struct.unpack("<BQ", head)
            left -= len(head) + length
            if kind not in _DATA:
                break
            if left < 0:
                if kind == _CHUNK and partly and not overwritten:
                    target.write(_begun(source.read()))
                break
            record = source.read(length)
            if kind != _CHUNK or _whole_chunk(record):
                target.write(head + record)
            elif overwritten or not partly:
                break
        target.write(_END)


def _mend_database(torn: Path, mended: Path) -> None:
    """Copy the readable rows of a database, including those in sqlite's files beside it."""
    copy = mended.with_name(f"torn_{torn.name}")
    for ending in ("", *_SIDE_FILES):
        with suppress(FileNotFoundError):
            shutil.copyfile(f"{torn}{ending}", f"{copy}{ending}")
    if not any(Path(f"{copy}{ending}").exists() for ending in _SIDE_FILES):
        with copy.open("r+b") as stream:
            stream.seek(_VALID_FOR)
            stream.write(bytes(4))  # now the size in the header is not believed
    with closing(sqlite3.connect(copy)) as source, closing(sqlite3.connect(mended)) as target:
        with suppress(sqlite3.DatabaseError):
            tables = source.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall()
            for _, sql in tables:
                target.execute(sql)
            for name, _ in sorted(tables, key=lambda table: table[0] == "messages"):
                with suppress(sqlite3.DatabaseError):
                    for row in source.execute(f"SELECT * FROM {name}"):  # noqa: S608 - a table of its own
                        target.execute(f"INSERT INTO {name} VALUES ({', '.join('?' * len(row))})", row)  # noqa: S608
        target.commit()


def _listed(folder: Path) -> list[str] | None:
    """Return the files that ``metadata.yaml`` lists; None if it is missing or unreadable."""
    try:
        content = yaml.safe_load((folder / "metadata.yaml").read_text())
        return [Path(name).name for name in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (FileNotFoundError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return None


@contextmanager
def readable(bag: Path, *, damaged: bool = False) -> Iterator[BagFiles]:
    """Yield what of a bag can be read: the bag, or temporary copies of its files if its writer was killed.

    ``bag`` is a folder, or an mcap or sqlite3 file; readers refuse anything else. ``damaged``: the bag is known to be
    unreadable as it is, so every complete message of its files is copied.
    """
    damage: list[str] = []
    listed: list[str] | None
    if not bag.is_dir():
        found, listed = [bag] if bag.exists() else [], [bag.name]
    else:
        found, listed = sorted([*bag.glob("*.mcap"), *bag.glob("*.db3")]), _listed(bag)
        if found and listed is None:
            damage.append("metadata.yaml is missing or cannot be read: the recorder was not ended as it should be")
    damage += [f"{name} is missing" for name in listed or () if name not in {file.name for file in found}]
    torn = {".mcap": _is_torn_mcap, ".db3": _is_torn_database}
    broken = {file for file in found if file.suffix in torn and (damaged or torn[file.suffix](file))}
    if not found or (not broken and not damage) or any(file.suffix not in torn for file in found):
        yield BagFiles([bag])
        return
    with TemporaryDirectory() as folder:
        paths = []
        for file in found:
            copy = Path(folder, file.name)
            if file not in broken:
                paths.append(file)
                continue
            if file.suffix == ".mcap":
                _mend_mcap(file, copy, partly=damaged)
            else:
                _mend_database(file, copy)
            paths.append(copy)
            ended = damaged and not torn[file.suffix](file)
            damage.append(f"{file.name} {'is damaged' if ended else 'has no end'}: what can be read of it is shown")
        yield BagFiles(paths, tuple(damage))


def reason_of(error: Exception) -> str:
    """Return why a bag cannot be read: what its reader says, but not what Python says of bytes that make no sense."""
    said = " ".join(str(error).split())
    return said if isinstance(error, AnyReaderError) and "(" not in said else "it is damaged, or something else"


@contextmanager
def opened(bag: Path, *, damaged: bool = False) -> Iterator[tuple[AnyReader, tuple[str, ...]]]:
    """Yield a reader of what `readable` finds of a bag, and what is wrong with its files.

    Raises
    ------
    Exception
        Whatever a reader raises if there is no bag or on damaged bytes.
    """
    with (
        readable(bag, damaged=damaged) as files,
        AnyReader(files.paths, default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader,
    ):
        yield reader, files.damage


@contextmanager
def reading(path: Path) -> Iterator[tuple[AnyReader, tuple[str, ...]]]:
    """Yield a reader of a bag, and what is wrong with its files.

    Raises
    ------
    OSError
        If there is none, or it may not be read.
    ValueError
        If it is no rosbag2.
    """
    path.stat()
    with ExitStack() as stack:
        try:
            reader, damage = stack.enter_context(opened(path))
        except PermissionError:
            raise
        except Exception as error:  # whatever a reader raises on other bytes
            raise ValueError(f"{path}: is no rosbag2 that can be read: {reason_of(error)}") from error
        yield reader, damage


def messages_of(reader: AnyReader, topics: Collection[str], path: Path) -> Iterator[tuple[str, int, Any]]:
    """Yield the topic, the time of receipt (ns) and the content of each message on ``topics``.

    Raises
    ------
    ValueError
        If one cannot be read.
    """
    chosen = [connection for connection in reader.connections if connection.topic in topics]
    found = reader.messages(chosen)
    while True:
        try:
            connection, received, raw = next(found)
            message = reader.deserialize(raw, connection.msgtype)
        except StopIteration:
            return
        except Exception as error:  # whatever a reader raises on damaged bytes
            raise ValueError(
                f"{path}: is damaged: backlash report shows what can be read of it ({reason_of(error)})"
            ) from error
        yield connection.topic, received, message
