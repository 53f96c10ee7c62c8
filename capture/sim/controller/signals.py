"""Electrical outputs: what clients switch through RTDE, as bits and as volts or amperes.

Universal Robots, "Real-Time Data Exchange guide": of `actual_digital_output_bits` 0 to 7 are the standard outputs, 8 to 15 the
configurable ones, 16 and 17 those of the tool. An analogue output is set as a share of its range: 4 to 20 mA, or 0 to 10 V if its
bit in the type is set.
"""

from typing import Any

FIRST_BIT = {"standard": 0, "configurable": 8, "tool": 16}
"""Lowest bit of each kind of digital outputs."""
ANALOG = 2  # outputs
LEAST_A, MOST_A, MOST_V = 0.004, 0.020, 10.0
NAMES = frozenset(f"{kind}_digital_output{end}" for kind in FIRST_BIT for end in ("", "_mask")) | {
    "standard_analog_output_mask",
    "standard_analog_output_type",
    *(f"standard_analog_output_{number}" for number in range(ANALOG)),
}
"""Input variables of RTDE that set them."""


class Signals:
    """The outputs as they are now."""

    def __init__(self) -> None:
        self.digital = 0
        """Bit by bit, as `actual_digital_output_bits` has them."""
        self.analog = [LEAST_A] * ANALOG
        """[A] or, `volts`, [V]."""
        self.volts = [False] * ANALOG

    def write(self, values: dict[str, Any]) -> None:
        """Set the outputs whose bits are in the masks; the others stay as they are."""
        for kind, first in FIRST_BIT.items():
            mask = int(values.get(f"{kind}_digital_output_mask", 0))
            bits = int(values.get(f"{kind}_digital_output", 0)) & mask
            self.digital = self.digital & ~(mask << first) | bits << first
        mask, types = (int(values.get(f"standard_analog_output_{name}", 0)) for name in ("mask", "type"))
        for number in range(ANALOG):
            share = min(max(float(values.get(f"standard_analog_output_{number}", 0.0)), 0.0), 1.0)
            if mask >> number & 1:
                self.volts[number] = bool(types >> number & 1)
                self.analog[number] = share * MOST_V if self.volts[number] else LEAST_A + share * (MOST_A - LEAST_A)
