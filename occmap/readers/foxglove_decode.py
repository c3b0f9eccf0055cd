"""From JSON or protobuf bytes to objects with the fields of Foxglove's schemas."""

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

from occmap.errors import LogError
from occmap.readers.ros_source import Channel

if TYPE_CHECKING:
    from google.protobuf.descriptor_pb2 import FileDescriptorProto

T = TypeVar("T")
TIME = "google.protobuf.Timestamp"


def make_foxglove_reader(
    channel: Channel, convert: Callable[[Any, str, int], T]
) -> Callable[[memoryview, int], T]:
    """Build the function that reads a channel's messages.

    Raises
    ------
    LogError
        The messages are protobuf and cannot be decoded here.
    """
    decode = decode_json if channel.encoding == "json" else make_protobuf_decoder(channel)
    return lambda data, record_ns: convert(decode(data), channel.topic, record_ns)


def decode_json(data: memoryview) -> Any:
    """Decode a JSON object; raises ValueError where it is none.

    JSON has no infinity: writers leave a null or a name, which NumPy reads as nan or infinity.
    """
    return json.loads(bytes(data), object_hook=lambda fields: SimpleNamespace(**fields))


def make_protobuf_decoder(channel: Channel) -> Callable[[memoryview], Any]:
    """Build a decoder by the descriptors that lie in the log.

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
            fix="pip install 'occmap[foxglove]' reads it",
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
            raise ValueError(str(error)) from error
        return _simplify(message)

    return decode


def _load_message(channel: Channel) -> Callable[[], Any]:
    """Load the message class, giving the pool each file after those that it is made of."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # noqa: PLC0415

    files = descriptor_pb2.FileDescriptorSet.FromString(channel.descriptors).file
    by_name = {file.name: file for file in files}
    pool = descriptor_pool.DescriptorPool()
    added: set[str] = set()

    def add(file: "FileDescriptorProto") -> None:
        if file.name in added:
            return
        added.add(file.name)
        for name in file.dependency:
            if name in by_name:
                add(by_name[name])
        pool.Add(file)

    for file in files:
        add(file)
    make: Callable[[], Any] = message_factory.GetMessageClass(
        pool.FindMessageTypeByName(channel.type)
    )
    return make


def _simplify(message: Any) -> Any:
    """Turn a protobuf message into what `decode_json` gives, arrays of numbers excepted."""
    if message.DESCRIPTOR.full_name == TIME:
        return SimpleNamespace(sec=message.seconds, nsec=message.nanos)
    fields = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            fields[field.name] = value
        elif field.is_repeated:
            fields[field.name] = [_simplify(item) for item in value]
        else:
            fields[field.name] = _simplify(value)
    return SimpleNamespace(**fields)
