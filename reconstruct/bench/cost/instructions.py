"""Attributes the instructions of a compiled step to parts of the source.

The compiler records the call stack of each instruction. An instruction belongs to a stage of the step (samples, surface
points, second pass, ...) by the functions on its stack, to a kernel by the modules on it, and to the forward or the
backward pass. A fusion is attributed by its heaviest instruction: a matrix product, else a scatter, else a gather, else the
last.
"""

import re
from collections import defaultdict
from typing import NamedTuple

STAGES = {
    "_with_second_pass": "second pass",
    "surface_point_terms": "surface points",
    "descended": "optimiser",
    "batch": "choosing samples",
    "noted": "occupancy grid",
    "kept_up": "occupancy grid",
    "take": "drawing rays",
    "decay_term": "decay",
}
"""Stage by a function on the stack; everything else belongs to the samples along the rays."""
SAMPLES = "samples on rays"
KERNELS = {
    "kernels/encoding.py": "encoding",
    "sampling/compiled.py": "packing",
    "kernels/adam.py": "optimiser",
    "encodings/directional.py": "shading",
    "encodings/": "encoding",
    "mlp.py": "networks",
    "appearance.py": "shading",
    "rendering/": "compositing",
    "numerics/volume.py": "compositing",
    "sampling/samples.py": "compositing",
    "sampling/packing.py": "packing",
    "sampling/occupancy.py": "occupancy",
    "losses.py": "losses",
    "surface/": "losses",
    "safe.py": "shading",
    "optax/": "optimiser",
}
"""Kernel by a module on the stack; the innermost listed one decides."""
CONTAINERS = frozenset({"while", "conditional", "call"})  # instructions whose time is that of the instructions inside them


class Part(NamedTuple):
    """What an instruction belongs to."""

    stage: str
    kernel: str
    backward: bool


HEAVY = ("dot", "convolution", "scatter", "gather")  # operations that decide for a fusion, heaviest first
_INSTRUCTION = re.compile(r"^\s*(?:ROOT )?%?([\w.\-]+) = (.*)$")
_KIND = re.compile(r"^\S+ ([\w\-]+)\(")
_COMPUTATION, _CALLED = re.compile(r"^%?([\w.\-]+) \("), re.compile(r"calls=%([\w.\-]+)")
_FRAME, _OPERATION = re.compile(r"stack_frame_id=(\d+)"), re.compile(r'op_name="([^"]*)"')


def parts_of(program: str) -> dict[str, Part]:
    """Part of each instruction of an optimised program (XLA's text), by name; without containers."""
    stacks, heaviest, computation, named = _stacks(program), {}, "", {}
    for line in program.splitlines():
        if match := _COMPUTATION.match(line):
            computation = match[1]
        if (match := _INSTRUCTION.match(line)) is None:
            continue
        kind = _kind(match[2])
        named[match[1]] = (kind, line)
        if kind in HEAVY and _FRAME.search(line):
            before = heaviest.get(computation)
            if before is None or HEAVY.index(kind) < HEAVY.index(before[0]):
                heaviest[computation] = (kind, line)
    parts = {}
    for name, (kind, line) in named.items():
        called = _CALLED.search(line) if kind == "fusion" else None
        telling = heaviest.get(called[1], (kind, line))[1] if called else line
        frame, operation = _FRAME.search(telling), _OPERATION.search(telling)
        if kind not in CONTAINERS:
            parts[name] = part_of(stacks.get(int(frame[1]), []) if frame else [], operation[1] if operation else "")
    return parts


def module_of(program: str) -> str:
    """Name of a program."""
    match = re.match(r"HloModule ([\w.\-]+)", program)
    return match[1] if match else ""


def _kind(instruction: str) -> str:
    """Operation of an instruction, which follows the type: "f32[3]{0} add(...)", "(s32[], f32[]) while(...)"."""
    if instruction.startswith("("):
        depth = 0
        for end, letter in enumerate(instruction):
            depth += (letter == "(") - (letter == ")")
            if depth == 0:
                instruction = f"tuple{instruction[end + 1 :]}"
                break
    match = _KIND.match(instruction)
    return match[1] if match else ""


def part_of(calls: list[tuple[str, str]], operation: str) -> Part:
    """Part of an instruction from its call stack (file, function), innermost first, and the name of its operation."""
    stage = next((STAGES[function] for _, function in calls if function in STAGES), SAMPLES if calls else "copies")
    kernels = (kernel for file, _ in calls for place, kernel in KERNELS.items() if place in file)
    kernel = stage if stage == "optimiser" else next(kernels, "other")
    return Part(stage, kernel, "transpose(" in operation)


def _stacks(program: str) -> dict[int, list[tuple[str, str]]]:
    """Call stack (file, function) of each frame, innermost first, from the tables at the head of a program."""
    tables: dict[str, dict[int, str]] = defaultdict(dict)
    title = ""
    for line in program.splitlines():
        if line in ("FileNames", "FunctionNames", "FileLocations", "StackFrames"):
            title = line
        elif title and (match := re.match(r"^(\d+) (.*)$", line)):
            tables[title][int(match[1])] = match[2].strip('"')
        elif line.startswith("%") or line.startswith("ENTRY"):
            break
    numbers = lambda text: {name: int(value) for name, value in re.findall(r"(\w+)=(\d+)", text)}  # noqa: E731
    places = {index: numbers(text) for index, text in tables["FileLocations"].items()}
    frames = {index: numbers(text) for index, text in tables["StackFrames"].items()}

    shifted = any(frame.get("parent_frame_id") == index for index, frame in frames.items())  # some versions count parents from 1

    def calls(index: int) -> list[tuple[str, str]]:
        found: list[tuple[str, str]] = []
        while index in frames:
            place = places[frames[index]["file_location_id"]]
            function = tables["FunctionNames"].get(place["function_name_id"], "")
            found.append((tables["FileNames"].get(place["file_name_id"], ""), function.rsplit(".", 1)[-1]))
            index = frames[index].get("parent_frame_id", 0) - shifted
        return found

    return {index: calls(index) for index in frames}
