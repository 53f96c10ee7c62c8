"""Framing and packing byte by byte."""

import struct

import pytest

from koala3d.capture.drivers.ur.rtde import wire
from koala3d.capture.drivers.ur.rtde.wire import Recipe, packet, split_packets


def test_packets_survive_any_split():
    stream = packet(86, b"\x00\x02") + packet(118) + packet(85, bytes(200))
    assert stream[:5] == b"\x00\x05V\x00\x02"
    buffer, found = bytearray(), []
    for byte in stream:
        buffer.append(byte)
        found += split_packets(buffer)
    assert found == [(86, b"\x00\x02"), (118, b""), (85, bytes(200))] and not buffer


def test_an_impossible_size_is_refused():
    with pytest.raises(ValueError, match="size 2"):
        list(split_packets(bytearray(b"\x00\x02V")))


def test_recipes_pack_in_order_and_back():
    recipe = Recipe(["timestamp", "actual_q", "robot_mode", "actual_digital_output_bits"])
    packed = recipe.pack([1.5, range(6), -7, 3])
    assert packed == struct.pack(">d6diQ", 1.5, *range(6), -7, 3)
    assert recipe.unpack(packed) == {
        "timestamp": 1.5,
        "actual_q": [0, 1, 2, 3, 4, 5],
        "robot_mode": -7,
        "actual_digital_output_bits": 3,
    }
    with pytest.raises(ValueError, match="67 bytes"):
        recipe.unpack(packed[:-1])


def test_types_and_registers():
    assert wire.type_of("output_int_register_47") == "INT32" and wire.type_of("input_double_register_48") == "NOT_FOUND"
    assert wire.register_of("input_double_register_24") == ("double", 24) and wire.register_of("actual_q") is None
    assert not Recipe(["actual_q", "actual_p"]).complete
