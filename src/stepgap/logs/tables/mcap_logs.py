"""MCAP files with messages in JSON, protobuf, or the formats of ROS."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from stepgap.logs.tables.files import LARGEST_FILE, LARGEST_PART, check_file_size, decompress_part, library, reading
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.messages import Decoder, TopicRows, unreadable
from stepgap.logs.tables.ros_messages import defined_decoders, standard_decoders

MCAP_MAGIC = b"\x89MCAP0\r\n"

ROS_FORMS = (("cdr", "ros2msg"), ("cdr", "ros2idl"), ("ros1", "ros1msg"))
"""Encodings of messages of ROS, each with the language of their definitions."""


def read_mcap(paths: Sequence[Path], unread: dict[str, str], release: str = "") -> dict[str, LogTable]:
    """One table for each topic, with `log_time` [s]; several files are parts of one log.

    Args:
        paths: The files.
        unread: The topics that cannot be read are added to it, with the reasons.
        release: Release of ROS 2 that recorded the log, if it is known.
    """
    topics = TopicRows(str(paths[0]))
    for path in paths:
        check_file_size(path)
        with reading(path, "MCAP"), path.open("rb") as file:
            for topic, time, data, decoders in _messages(file, path, release):
                topics.append(topic, time, data, decoders)
    return topics.tables(unread)


def _messages(file: Any, path: Path, release: str) -> Iterator[tuple[str, int, bytes, Sequence[Decoder]]]:
    """Yields topic, time [ns], content and possible decoders of the messages."""
    from mcap.records import Channel, Message, Schema

    schemas: dict[int, Any] = {}
    channels: dict[int, tuple[str, Sequence[Decoder]]] = {}
    for record in _records(file):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in channels:
            schema = schemas.get(record.schema_id)
            channels[record.id] = record.topic, _decoders(record.message_encoding, schema, path, release)
        elif isinstance(record, Message):
            topic, decoders = channels[record.channel_id]
            yield topic, record.log_time, record.data, decoders


def _records(file: Any) -> Iterator[Any]:
    """Yields the records of the data, those in chunks included."""
    from mcap.records import Chunk, DataEnd
    from mcap.stream_reader import StreamReader, breakup_chunk

    size = 0
    for record in StreamReader(file, emit_chunks=True, record_size_limit=LARGEST_PART).records:
        if isinstance(record, DataEnd):
            return
        if not isinstance(record, Chunk):
            yield record
            continue
        record.data = decompress_part(record.data, record.compression)
        record.compression = ""
        size += len(record.data)
        if size > LARGEST_FILE:
            raise ValueError(f"larger than {LARGEST_FILE} bytes when decompressed")
        yield from breakup_chunk(record, validate_crc=True)


def _decoders(encoding: str, schema: Any, path: Path, release: str) -> list[Decoder]:
    """The functions that may decode the messages of a channel."""
    if encoding == "json":
        return [_json]
    form = schema.encoding if schema is not None else ""
    if schema is not None and encoding == form == "protobuf":
        return [_protobuf_decoder(schema, path)]
    if schema is not None and (encoding, form) in ROS_FORMS:
        return defined_decoders(path, schema.name, schema.data.decode("utf-8", "replace"), form, release)
    if encoding == "cdr" and schema is not None:
        return standard_decoders(path, schema.name, release)
    return [unreadable(f"messages in {encoding!r:.60}, not read; JSON, protobuf and ROS messages are")]


def _protobuf_decoder(schema: Any, path: Path) -> Decoder:
    factory = library("mcap_protobuf.decoder", path).DecoderFactory()
    try:
        decode = factory.decoder_for("protobuf", schema)
    except Exception:
        return unreadable(f"the definition of {schema.name:.80} cannot be read")
    return lambda data: _protobuf_tree(decode(data))


def _json(data: bytes) -> Any:
    tree = json.loads(data, parse_constant=lambda _: None)
    if not isinstance(tree, dict):
        raise ValueError("a JSON message that is not an object")
    return tree


def _protobuf_tree(message: Any) -> Any:
    """A message as a tree; a field that knows that it is absent is left out, others have their default."""
    if not hasattr(message, "DESCRIPTOR"):
        return message
    tree: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        if field.has_presence and not message.HasField(field.name):
            continue
        value = getattr(message, field.name)
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            tree[field.name] = {str(key): _protobuf_tree(value[key]) for key in value}
        elif isinstance(value, str | bytes | int | float) or hasattr(value, "DESCRIPTOR"):
            tree[field.name] = _protobuf_tree(value)
        else:
            tree[field.name] = [_protobuf_tree(part) for part in value]
    return tree
