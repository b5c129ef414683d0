"""Give an ONNX network another input size without the `onnx` package.

An ONNX file is a protobuf message: a row of fields, each a key (number and wire type) and a value.
Only the few fields that state shapes are rewritten here; everything else is copied byte for byte.
The numbers are those of onnx.proto: a model's graph is field 7, a graph's inputs, outputs and notes
on tensors between them are 11, 12 and 13, a value's name and type 1 and 2.
"""

from __future__ import annotations

from collections.abc import Iterator

_GRAPH, _INPUT, _OUTPUT, _VALUE_NOTES = 7, 11, 12, 13
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_FLOAT = 1


def with_input_size(model: bytes, shape: tuple[int, ...]) -> bytes:
    """Return the network with its only input declared as `shape` and its other sizes left open.

    It works for a network whose layers do not themselves hold a size, as convolutions, pooling
    over everything and matrix products over channels do not.

    Raises:
        ValueError: this is no ONNX file, or its graph has other than one input.
    """
    parts = [
        _field(number, _resized_graph(value, shape)) if number == _GRAPH else raw
        for number, value, raw in _fields(model)
    ]
    return b"".join(parts)


def _resized_graph(graph: bytes, shape: tuple[int, ...]) -> bytes:
    inputs = sum(number == _INPUT for number, _, _ in _fields(graph))
    if inputs != 1:
        raise ValueError(f"this network has {inputs} inputs; only one can be given another size")
    return b"".join(
        _resized_field(number, value, raw, shape) for number, value, raw in _fields(graph)
    )


def _resized_field(number: int, value: bytes, raw: bytes, shape: tuple[int, ...]) -> bytes:
    if number == _INPUT:
        return _field(_INPUT, _value_info(_name(value), shape))
    if number == _OUTPUT:
        return _field(_OUTPUT, _value_info(_name(value), None))
    return b"" if number == _VALUE_NOTES else raw


def _value_info(name: bytes, shape: tuple[int, ...] | None) -> bytes:
    """Encode a float tensor's name, type and, if known, shape."""
    tensor = _varint(1 << 3) + _varint(_FLOAT)
    if shape is not None:
        sizes = (_field(1, _varint(1 << 3) + _varint(size)) for size in shape)
        tensor += _field(2, b"".join(sizes))
    return _field(1, name) + _field(2, _field(1, tensor))


def _name(value_info: bytes) -> bytes:
    return next(value for number, value, _ in _fields(value_info) if number == 1)


def _fields(message: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield number, value (of length-delimited fields) and raw bytes of each field in turn."""
    at = 0
    while at < len(message):
        key, value_at = _read_varint(message, at)
        start, end = _value_span(message, value_at, key & 7)
        if end > len(message):
            raise ValueError("this is no ONNX file: a field reaches beyond the end")
        yield key >> 3, message[start:end], message[at:end]
        at = end


def _value_span(message: bytes, at: int, wire_type: int) -> tuple[int, int]:
    if wire_type == _VARINT:
        return at, _read_varint(message, at)[1]
    if wire_type == _BYTES:
        length, start = _read_varint(message, at)
        return start, start + length
    if wire_type in (_FIXED64, _FIXED32):
        return at, at + (8 if wire_type == _FIXED64 else 4)
    raise ValueError(f"this is no ONNX file: wire type {wire_type}")


def _read_varint(message: bytes, at: int) -> tuple[int, int]:
    """Return the number that starts at `at`, and where it ends."""
    value = shift = 0
    while at < len(message):
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise ValueError("this is no ONNX file: it ends within a number")


def _varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _field(number: int, value: bytes) -> bytes:
    return _varint(number << 3 | _BYTES) + _varint(len(value)) + value
