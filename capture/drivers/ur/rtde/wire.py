"""RTDE: framing, and how values are packed. All numbers are big-endian. Our client and the simulated controller use it.

A packet is uint16 size (header included), uint8 type, payload (Universal Robots, "Real-Time Data Exchange guide").
"""

import re
import struct
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

PROTOCOL_VERSION, CONTROLLER_VERSION, OUTPUTS, INPUTS, START, PAUSE, DATA, TEXT = (ord(letter) for letter in "VvOISPUM")
VERSIONS = (1, 2)

MAX_DATA = 2**16 - 5  # bytes of values that fit into a packet

_CODES = {"BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d"}
_CODES |= {"VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i"}


def _types(**names: str) -> dict[str, str]:
    return {name: kind for kind, listed in names.items() for name in listed.split()}


OUTPUT_TYPES = _types(
    VECTOR6D="target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
    "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed "
    "joint_temperatures actual_joint_voltage payload_inertia actual_current_as_torque ft_raw_wrench",
    DOUBLE="timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage "
    "actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1 standard_analog_output0 "
    "standard_analog_output1 payload tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature "
    "tcp_force_scalar",
    INT32="robot_mode safety_mode tool_output_voltage",
    UINT32="runtime_state robot_status_bits safety_status_bits tool_mode tool_analog_input_types "
    "output_bit_registers0_to_31 output_bit_registers32_to_63 input_bit_registers0_to_31 input_bit_registers32_to_63",
    UINT64="actual_digital_input_bits actual_digital_output_bits",
    VECTOR3D="actual_tool_accelerometer payload_cog elbow_position elbow_velocity",
    VECTOR6INT32="joint_mode",
)
INPUT_TYPES = _types(
    UINT8="standard_digital_output standard_digital_output_mask configurable_digital_output configurable_digital_output_mask "
    "tool_digital_output tool_digital_output_mask standard_analog_output_mask standard_analog_output_type",
    UINT32="speed_slider_mask",
    DOUBLE="speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    VECTOR6D="external_force_torque",
)
"""The variables that a client may read, and those that it may set, with their types; registers come on top."""

_REGISTER = re.compile(r"(input|output)_(int|double|bit)_register_(\d{1,3})$")


@lru_cache(1024)
def type_of(name: str, *, is_input: bool = False) -> str:
    """RTDE type of a variable that a client reads or, `is_input`, sets; NOT_FOUND where there is none of that name."""
    register = _REGISTER.match(name)
    if register is None:
        return (INPUT_TYPES if is_input else OUTPUT_TYPES).get(name, "NOT_FOUND")
    kind, number = register[2], int(register[3])
    if number >= (128 if kind == "bit" else 48) or (is_input and register[1] != "input"):
        return "NOT_FOUND"
    return {"int": "INT32", "double": "DOUBLE", "bit": "BOOL"}[kind]


@lru_cache(1024)
def register_of(name: str) -> tuple[str, int] | None:
    """("int" or "double", number) of an int or double register of either direction, else None."""
    register = _REGISTER.match(name)
    return (register[2], int(register[3])) if register and register[2] != "bit" else None


class Recipe:
    """A list of variables that travel together: to a client or, `is_input`, from it."""

    def __init__(self, names: Sequence[str], *, is_input: bool = False) -> None:
        self.names = list(names)
        self.types = [type_of(name, is_input=is_input) for name in self.names]
        self.packing = struct.Struct(">" + "".join(_CODES[kind] for kind in self.types if kind in _CODES))

    @property
    def complete(self) -> bool:
        """False where a variable does not exist, or all of them do not fit into a packet."""
        return "NOT_FOUND" not in self.types and self.packing.size <= MAX_DATA

    def pack(self, values: Sequence[Any]) -> bytes:
        """Bytes of one value (number or sequence) per name."""
        flat: list[Any] = []
        for value in values:
            flat.extend(value) if hasattr(value, "__len__") else flat.append(value)
        return self.packing.pack(*flat)

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """Name to number or list; raises ValueError where the size is wrong."""
        if len(payload) != self.packing.size:
            raise ValueError(f"{len(payload)} bytes where the recipe has {self.packing.size}")
        numbers = iter(self.packing.unpack(payload))
        values: dict[str, Any] = {}
        for name, kind in zip(self.names, self.types, strict=True):
            length = int(_CODES[kind][:-1] or 1)
            values[name] = next(numbers) if length == 1 else [next(numbers) for _ in range(length)]
        return values


def packet(kind: int, payload: bytes = b"") -> bytes:
    """One framed packet."""
    return struct.pack(">HB", len(payload) + 3, kind) + payload


def text_message(text: str, version: int) -> bytes:
    """The packet by which a controller tells its clients of an error."""
    message, source = text.encode()[:250], b"controller"
    if version == 1:
        return packet(TEXT, b"\x01" + message)
    return packet(TEXT, bytes([len(message)]) + message + bytes([len(source)]) + source + b"\x01")


def split_packets(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """(type, payload) of every complete packet, removed from `buffer`; raises ValueError on an impossible size."""
    while len(buffer) >= 3:
        size, kind = struct.unpack_from(">HB", buffer)
        if size < 3:
            raise ValueError(f"packet of size {size}")
        if len(buffer) < size:
            return
        payload = bytes(buffer[3:size])
        del buffer[:size]
        yield kind, payload
