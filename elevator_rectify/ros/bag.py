"""Reading and writing rosbags without ROS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from elevator_rectify.ros.messages import MakeRosbags
from elevator_rectify.ros.vision_types import DEFINITIONS

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
TYPESTORE.register({k: v for name, text in DEFINITIONS.items() for k, v in get_types_from_msg(text, name).items()})
make_bag_message = MakeRosbags(TYPESTORE)
# 9 does not play on Humble.
_VERSION: Literal[8] = 8
# Suffixes of the files that hold a bag's messages.
_STORED = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


class BadBag(ValueError):
    """A bag that cannot be used; the text says which and why."""


class BagWriter:
    """Writes messages by topic; use as `with bag_writer(path) as bag`."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, kind: str, message: Any, time_ns: int) -> None:
        """Append a rosbags message of type `kind`."""
        self.write_raw(topic, kind, TYPESTORE.serialize_cdr(message, kind), time_ns)

    def write_raw(self, topic: str, kind: str, data: bytes | memoryview, time_ns: int) -> None:
        """Append a serialised message."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=TYPESTORE)
        self._writer.write(self._connections[topic], time_ns, data)


@contextmanager
def bag_writer(path: Path) -> Iterator[BagWriter]:
    """Open a new mcap bag; raise BadBag where the path is taken.

    What was written is kept and readable, whatever ends the writing: rosbags itself would drop the bag's metadata.
    """
    if path.exists():
        raise BadBag(f"{path} exists already")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        writer = Writer(path, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.open()
        try:
            yield BagWriter(writer)
        finally:
            writer.close()
    except OSError as error:
        raise BadBag(f"{path} cannot be written: {error}") from error


class Unreadable(ValueError):
    """A recorded message whose bytes are not of its type, or whose type is not known."""


@dataclass(frozen=True)
class Record:
    """One recorded message: topic, type name, log time, serialised bytes and, on demand, the message."""

    topic: str
    kind: str
    time_ns: int
    data: bytes
    number: int = 0
    typestore: Any = TYPESTORE

    @property
    def message(self) -> Any:
        """Return the deserialised rosbags message. Raises Unreadable."""
        try:
            return self.typestore.deserialize_cdr(self.data, self.kind)
        except Exception as error:
            # rosbags raises what its generated code meets in damaged bytes: struct, index, memory, unicode errors.
            raise Unreadable(f"{self.topic}: not a {self.kind}: {error!r:.200}") from error


def bag_topics(path: Path) -> dict[str, tuple[str, int]]:
    """Return {topic: (type name, number of messages)}; raise BadBag where there is no readable bag."""
    with _opened(path) as reader:
        topics: dict[str, tuple[str, int]] = {}
        for c in reader.connections:
            topics[c.topic] = str(c.msgtype), topics.get(c.topic, ("", 0))[1] + int(c.msgcount)
        return topics


def read_bag(path: Path, topics: set[str] | None = None) -> Iterator[Record]:
    """Yield the records of the topics (all where None) in log order.

    Raises BadBag where the bag breaks off, after all that could be read was yielded.
    """
    with _opened(path) as reader:
        chosen = [c for c in reader.connections if topics is None or c.topic in topics]
        stores = {c.id: _typestore(c) for c in chosen}
        try:
            for number, (connection, time_ns, data) in enumerate(reader.messages(chosen) if chosen else ()):
                yield Record(connection.topic, connection.msgtype, time_ns, bytes(data), number, stores[connection.id])
        except Exception as error:
            # As above: whatever the storage's parser meets in damaged bytes.
            raise BadBag(f"{path} breaks off: {error!r:.200}") from error


def _typestore(connection: Connection) -> Any:
    """Return the types by which a topic is read: those that the bag brings, where they can be read, else Jazzy's.

    One topic of a type that nobody knows, such as a service's events, must not make the others unreadable.
    """
    if connection.msgdef.format is not MessageDefinitionFormat.MSG:
        return TYPESTORE
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
    except Exception:
        return TYPESTORE
    return store


@contextmanager
def _opened(path: Path) -> Iterator[Reader]:
    if path.suffix == ".bag" or (path.is_file() and path.open("rb").read(9) == b"#ROSBAG V"):
        raise BadBag(f"{path} is a bag of ROS 1: convert it, rosbags-convert --src {path} --dst FOLDER")
    if path.is_dir() and not (path / "metadata.yaml").exists() and any(path.glob(f"*{kind}") for kind in _STORED):
        raise BadBag(f"{path} has no metadata.yaml, its recording was cut off: ros2 bag reindex {path} may mend it")
    try:
        reader = Reader(path)
        reader.open()
    except Exception as error:
        # rosbags raises what its parsers raise on a damaged file: struct, assertion, lookup, yaml errors.
        raise BadBag(f"{path} is no readable bag: {error!r:.300}") from error
    try:
        yield reader
    finally:
        reader.close()
