"""From JSON or protobuf bytes to messages of Foxglove's schemas."""

import json
from collections.abc import Callable
from graphlib import TopologicalSorter
from typing import Any

from occmap.errors import DamageError, LogError
from occmap.readers.ros_source import Channel

MAX_FILES = 1000
"""Files of a schema at most; Foxglove's own needs six."""


def make_json_decoder(_channel: Channel) -> Callable[[memoryview], Any]:
    """Give what decodes a JSON object; it raises DamageError where it is none."""

    def decode(data: memoryview) -> Any:
        try:
            return json.loads(bytes(data))
        except (ValueError, RecursionError, MemoryError) as error:
            raise DamageError(f"is no JSON ({type(error).__name__})") from error

    return decode


def make_protobuf_decoder(channel: Channel) -> Callable[[memoryview], Any]:
    """Build a decoder by the descriptors that lie in the log; it raises DamageError.

    Raises
    ------
    LogError
        The protobuf package is not installed, or the descriptors are damaged.
    """
    try:
        from google.protobuf.message import DecodeError  # noqa: PLC0415  an extra
    except ImportError:
        raise LogError(
            f"{channel.type} is written in protobuf",
            where=channel.topic,
            fix="install what reads it: pip install '.[foxglove]'",
        ) from None
    try:
        make = _load_message(channel)
    except (DecodeError, KeyError, TypeError, ValueError) as error:
        raise LogError(
            f"the definition of {channel.type} cannot be understood ({type(error).__name__})",
            where=channel.topic,
        ) from error

    def decode(data: memoryview) -> Any:
        message = make()
        try:
            message.ParseFromString(bytes(data))
        except DecodeError as error:
            raise DamageError("is not of its protobuf type") from error
        return message

    return decode


def _load_message(channel: Channel) -> Callable[[], Any]:
    """Load the message class, giving the pool each file after those that it is made of."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # noqa: PLC0415

    files = descriptor_pb2.FileDescriptorSet.FromString(channel.descriptors).file
    if len(files) > MAX_FILES:
        raise ValueError(f"{len(files)} files make one type")
    by_name = {file.name: file for file in files}
    pool = descriptor_pool.DescriptorPool()
    order = TopologicalSorter({file.name: file.dependency for file in files})
    for name in order.static_order():
        if name in by_name:
            pool.Add(by_name[name])
    make: Callable[[], Any] = message_factory.GetMessageClass(
        pool.FindMessageTypeByName(channel.type)
    )
    return make


DECODERS = {"json": make_json_decoder, "protobuf": make_protobuf_decoder}
"""What builds a decoder, for each way in which Foxglove's messages are written."""
