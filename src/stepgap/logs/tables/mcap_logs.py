"""MCAP files with messages in JSON, protobuf or ROS 2's CDR."""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from stepgap.logs.tables.decompression import LARGEST_PART, decompress_part
from stepgap.logs.tables.files import LARGEST_FILE, check_file_size
from stepgap.logs.tables.libraries import library, reading
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.messages import MessageRows, row_of_message
from stepgap.records.steps_csv import RecordError

MCAP_MAGIC = b"\x89MCAP0\r\n"

Decoder = Callable[[bytes], Any]


def read_mcap(paths: Sequence[Path]) -> dict[str, LogTable]:
    """One table for each topic, with `log_time` [s]; several files are parts of one log.

    A topic whose encoding is not known is refused only if no other topic can be read.
    """
    topics: dict[str, MessageRows] = {}
    unknown: dict[str, str] = {}
    for path in paths:
        check_file_size(path)
        with reading(path, "MCAP"), path.open("rb") as file:
            for topic, time, tree in _messages(file, path, unknown):
                rows = topics.setdefault(topic, MessageRows(f"{paths[0]}, {topic}"))
                rows.append(row_of_message(time, tree))
    if unknown and not topics:
        topic, encoding = next(iter(unknown.items()))
        raise RecordError(
            f"{paths[0]}, {topic}: messages in {encoding!r:.60}, not read; JSON, protobuf and ROS 2 messages are"
        )
    return {topic: rows.table(has_lines=False) for topic, rows in topics.items()}


def _messages(file: Any, path: Path, unknown: dict[str, str]) -> Iterator[tuple[str, int, Any]]:
    """Yields topic, time [ns] and content of the messages; notes the encodings of topics that cannot be read."""
    from mcap.records import Channel, Message, Schema

    schemas: dict[int, Any] = {}
    channels: dict[int, tuple[str, Decoder | None]] = {}
    for record in _records(file):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            decoder = _decoder(record.message_encoding, schemas.get(record.schema_id), path)
            channels[record.id] = record.topic, decoder
            if decoder is None:
                unknown[record.topic] = record.message_encoding
        elif isinstance(record, Message):
            topic, decoder = channels[record.channel_id]
            if decoder:
                yield topic, record.log_time, decoder(record.data)


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


def _decoder(encoding: str, schema: Any, path: Path) -> Decoder | None:
    """The function that decodes the messages of a channel; None if their encoding is not read."""
    if encoding == "json":
        return _json
    if encoding == "protobuf" and schema is not None and schema.encoding == "protobuf":
        decode = library("mcap_protobuf.decoder", path).DecoderFactory().decoder_for(encoding, schema)
        return lambda data: _protobuf_tree(decode(data))
    if encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        return cdr_decoder(schema.name, schema.data.decode(), path)
    return None


def cdr_decoder(name: str, definition: str, path: Path) -> Decoder:
    """The function that decodes ROS 2 messages of a type; it interprets the definition and compiles no code."""
    decode = library("mcap_ros2._dynamic", path).generate_dynamic(name, definition)[name]
    return lambda data: _ros_tree(decode(data))


def _json(data: bytes) -> Any:
    tree = json.loads(data, parse_constant=lambda _: None)
    if not isinstance(tree, dict):
        raise ValueError("a JSON message that is not an object")
    return tree


def _ros_tree(message: Any) -> Any:
    if isinstance(message, list):
        return [_ros_tree(part) for part in message]
    if not hasattr(message, "_full_text"):
        return message
    return {name: _ros_tree(getattr(message, name)) for name in type(message).__slots__}


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
