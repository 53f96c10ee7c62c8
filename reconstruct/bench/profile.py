"""Where the time of a training step goes: the compiled step itself is traced, and its instructions are told by the code they come from.

The compiler keeps for each instruction the calls that led to it. What is fused takes the calls of its last operation. An instruction belongs to
the stage of the step in whose function it began (samples, surface points, second pass, ...), within it to the module whose work it does, and
to the forward or the backward pass.
"""

import gzip
import json
import re
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from datasets.console import progress
from datasets.scene import Scene
from reconstruct.rays import Pixels
from reconstruct.step import TrainState
from reconstruct.trained import Trained

STEPS = 16
"""Steps that are traced, without and with a second pass."""
STAGES = {"second_pass_terms": "second pass", "surface_point_terms": "surface points", "_descend": "optimiser", "_choose": "choosing samples",
          "seen": "occupancy grid", "look_around": "occupancy grid", "take": "drawing rays", "decay_term": "decay"}  # fmt: skip
"""Function within whose call an instruction began, and the stage that it is of; all else is of the samples along the rays."""
SAMPLES = "samples on rays"
KERNELS = {"encodings/directional.py": "shading", "encodings/": "encoding", "mlp.py": "networks", "appearance.py": "shading", "rendering.py": "compositing",
           "sampling/samples.py": "compositing", "sampling/packing.py": "packing", "sampling/occupancy.py": "occupancy",
           "losses.py": "losses", "safe.py": "shading", "optax/": "optimiser"}  # fmt: skip
"""Module and the work that is done in it: of an instruction's calls, the innermost that is listed here decides."""
CONTAINERS = frozenset({"while", "conditional", "call"})
"""Instructions whose time is that of others inside them."""


class Part(NamedTuple):
    """What an instruction is for."""

    stage: str
    kernel: str
    backward: bool


def step_profile(trained: Trained, scene: Scene) -> dict[str, Any]:
    """Milliseconds per step, by part, of steps with and without the second pass.

    Returns:
        "step_ms" and "second_pass_step_ms" by the clock, untraced; "parts", rows of stage, kernel, "forward" or "backward", and
        milliseconds of a step without (or, for the stage of that name, of one with) second pass, longest first.
    """
    functions, views = trained.functions, scene.split("train")
    with progress("reading images", len(views), "images") as shown:
        pixels = Pixels.load(views, functions.normalisation, functions.config.scale, shown)
    advance = jax.jit(functions.advance).lower(*_arguments(trained.state, pixels, False)).compile()
    parts = parts_of(advance.as_text())
    plain_ms, plain = _traced(advance, trained.state, pixels, parts, second=False)
    second_ms, second = (
        _traced(advance, trained.state, pixels, parts, second=True) if functions.config.surface.enabled else (None, {})
    )
    found = plain | {part: value for part, value in second.items() if part.stage == "second pass"}
    rows = [[part.stage, part.kernel, "backward" if part.backward else "forward", value] for part, value in found.items()]
    return {"step_ms": plain_ms, "second_pass_step_ms": second_ms, "rays": functions.rays_per_step, "samples": functions.samples_per_step,
            "parts": sorted(rows, key=lambda row: -row[3])}  # fmt: skip


def _arguments(state: TrainState, pixels: Pixels, second: bool) -> tuple[Any, ...]:
    """Of `StepFunctions.advance`; with a second pass it is one step, else `STEPS`."""
    count = 1 if second else STEPS
    return (
        state,
        pixels,
        jnp.asarray(0, jnp.int32),
        jnp.asarray(0.9, jnp.float32),
        jnp.asarray(count, jnp.int32),
        jnp.asarray(second),
    )


def _traced(
    advance: Any, state: TrainState, pixels: Pixels, parts: dict[str, Part], *, second: bool
) -> tuple[float, dict[Part, float]]:
    """Milliseconds per step untraced (the fastest of three), and of each part."""
    arguments, repeats = _arguments(state, pixels, second), 1 if not second else STEPS
    steps = STEPS

    def go() -> float:
        start = time.perf_counter()
        for _ in range(repeats):
            jax.block_until_ready(advance(*arguments))
        return 1e3 * (time.perf_counter() - start) / steps

    untraced = min(go() for _ in range(3))
    with tempfile.TemporaryDirectory(prefix="koala-trace-") as folder:
        with jax.profiler.trace(folder):
            go()
        durations = durations_us(Path(folder))
    spent: dict[Part, float] = defaultdict(float)
    for name, microseconds in durations.items():
        part = parts.get(name)
        if part is not None:
            spent[part] += 1e-3 * microseconds / steps
    return untraced, dict(spent)


def durations_us(folder: Path) -> dict[str, float]:
    """Microseconds in each instruction of the traced programs, by its name."""
    spent: dict[str, float] = defaultdict(float)
    for path in folder.rglob("*.trace.json.gz"):
        with gzip.open(path) as file:
            events = json.load(file)["traceEvents"]
        for event in events:
            name = (event.get("args") or {}).get("hlo_op")
            if name is not None:
                spent[name] += event.get("dur", 0.0)
    return dict(spent)


_INSTRUCTION = re.compile(r"^\s*(?:ROOT )?%?([\w.\-]+) = (.*)$")
_KIND = re.compile(r"^\S+ ([\w\-]+)\(")
_FRAME, _OPERATION = re.compile(r"stack_frame_id=(\d+)"), re.compile(r'op_name="([^"]*)"')


def parts_of(program: str) -> dict[str, Part]:
    """Part of each instruction of an optimised program (XLA's text), by its name; containers are left out."""
    stacks = _stacks(program)
    parts = {}
    for line in program.splitlines():
        match = _INSTRUCTION.match(line)
        if match is None or _kind(match[2]) in CONTAINERS:
            continue
        frame, operation = _FRAME.search(line), _OPERATION.search(line)
        calls = stacks.get(int(frame[1]), []) if frame else []
        parts[match[1]] = part_of(calls, operation[1] if operation else "")
    return parts


def _kind(instruction: str) -> str:
    """What an instruction does, after the type of its result: "f32[3]{0} add(...)", "(s32[], f32[]) while(...)"."""
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
    """Part of an instruction by its calls (file, function), innermost first, and by the name of its operation."""
    stage = next((STAGES[function] for _, function in calls if function in STAGES), SAMPLES if calls else "copies")
    kernels = (kernel for file, _ in calls for place, kernel in KERNELS.items() if place in file)
    kernel = stage if stage == "optimiser" else next(kernels, "other")
    return Part(stage, kernel, "transpose(" in operation)


def _stacks(program: str) -> dict[int, list[tuple[str, str]]]:
    """Calls (file, function) of each stack frame, innermost first, from the tables at the head of a program."""
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
