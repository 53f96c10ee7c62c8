"""Two processes on this computer, over 127.0.0.1: what they agree on, and a training that comes to what one process comes to."""

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.training import distributed
from koala3d.reconstruct.training.batches import Division

PATIENCE_S = 840
"""For processes that compile on a computer that may be busy with other things."""
COMMAND = "from koala3d.reconstruct.cli import main; main()"
SMALL = [
    "encoding.levels=1",
    "encoding.log2_size=6",
    "field.spatial_width=4",
    "field.view_width=4",
    "field.bottleneck=2",
    "field.ide_degree=1",
    "sampler.grid=16",
    "sampler.rays=64",
    "sampler.steps=32",
    "sampler.samples=512",
    "surface.enabled=false",
    "train.steps=3",
]
TALK = """
import json, sys
from pathlib import Path

import jax, jax.numpy as jnp, numpy as np
from koala3d.datasets.core.errors import KoalaError
from koala3d.reconstruct.training import distributed

process, coordinator, folder = int(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
distributed.join(coordinator, 2, process)
said = {"writes": distributed.writes(), "devices": jax.device_count()}
said["gathered"] = distributed.gathered([1 / 3 + process, 2.0**60 + 256]).tolist()
said["decided"] = distributed.decided(0.1 + process)
said["text"] = distributed.decided_text("für alle" if process == 0 else "another, and longer")
distributed.require_same({"a": jnp.arange(3.0)}, "scene")
mesh = jax.sharding.Mesh(np.array(jax.devices()), ("rays",))
whole = distributed.on_all({"a": jnp.arange(6.0)}, jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec()))
said["own"] = np.asarray(jax.jit(lambda a: 2 * a)(distributed.own_copy(whole)["a"])).tolist()
complaints = []
def complain(action):
    try:
        action()
    except KoalaError as error:
        complaints.append(str(error))
complain(lambda: distributed.require_same({"a": jnp.arange(3.0) + process}, "scene"))
complain(lambda: distributed.folder_for(folder / "taken").__enter__())
complain(lambda: distributed.folder_for(folder / "none", resume=True).__enter__())
with distributed.folder_for(folder / "new") as own:
    own.mkdir()
    (own / "log").write_text(str(process))
    said["own folder"] = own == folder / "new"
distributed.gathered([0.0])  # the first process has made its folder
with distributed.folder_for(folder / "new", resume=True) as own:
    said["copied"] = (own / "log").read_text()
distributed.gathered([0.0])
print("SAID" + json.dumps({**said, "complaints": complaints, "left": own.exists()}), flush=True)
"""

WORK = '''
import hashlib, json, os, re, sys

os.environ["KOALA_KERNELS"] = "off"  # whose operations the compiler does not count
import jax, jax.numpy as jnp, numpy as np
from koala3d.reconstruct.field.encodings import grid
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training import distributed
from koala3d.reconstruct.training.batches import Division, drawn_batch
from koala3d.reconstruct.training.programs import traced
from koala3d.reconstruct.training.step import Step
from dataclasses import replace

grid.by_row = lambda: True  # as several devices do it
count, process, coordinator = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
if count > 1:
    distributed.join(coordinator, count, process)
small = """encoding.levels=1 encoding.log2_size=6 field.spatial_width=4 field.spatial_depth=1 field.view_width=4
field.view_depth=1 field.view_skip=0 field.bottleneck=2 field.ide_degree=1 sampler.grid=16 sampler.steps=32
sampler.samples=1024 sampler.proposals=[8,8] sampler.final=8 sampler.proposal_finest=[8,16] sampler.frustum=point
surface.enabled=false surface.rays=32"""
config = load_config("zipnerf", "paper", [*small.split(), "sampler.rays=1024"])
key, total = jax.random.key(0), 9999
pixels = Pixels(
    jax.random.uniform(key, (total, 4), jnp.float16), jax.random.normal(key, (total, 3)), jnp.arange(total) % 3,
    jnp.ones((3, 3)), jnp.ones(3),
)
step = Step.of(config, SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0)))
state = step.initial(key, None, 3)
step = replace(step, division=Division.among(jax.devices(), state.model.sampler.divided_sizes))
if count > 1:
    state = distributed.on_all(state, step.division.everywhere)
pixels = step.division.divided(pixels)
keys, looks = (jax.random.key(1), jax.random.key(2)), jnp.asarray(True)
draw = jax.jit(lambda model, pixels: drawn_batch(model, pixels, *keys, looks, step.division))
drawn = draw(state.model, pixels)
said = {}
if process == 0:  # all processes have the same program
    number, real, either = (jax.ShapeDtypeStruct((), dtype) for dtype in (jnp.int32, jnp.float32, jnp.bool))
    program = traced(step.begun, (state.model, state.step, pixels, number, real, either), step.division).lower().compile()
    gathers = [line for line in program.as_text().splitlines() if re.search("= .* all-gather[(-]", line)]
    shapes = [re.search(r"\\[([0-9,]+)\\]", line)[1].split(",") for line in gathers]
    said["gathered"] = max([0] + [int(np.prod([int(n) for n in shape])) for shape in shapes])
    said["operations"] = program.cost_analysis()["flops"]
said["pixels"] = [leaf.addressable_data(0).shape[0] for leaf in (pixels.colour, pixels.directions, pixels.view)]
said["rays"] = drawn.rays.directions.addressable_data(0).shape[0]
said["samples"] = said["rays"] * config.sampler.final
whole = jax.jit(lambda a: a, out_shardings=step.division.everywhere)((drawn.rays.directions, drawn.colour))
data = b"".join(np.asarray(leaf.addressable_data(0)).tobytes() for leaf in whole)
print("SAID" + json.dumps({**said, "digest": hashlib.sha256(data).hexdigest()}), flush=True)
'''


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def together(commands: list[list[str]], cache: Path) -> list[tuple[int, str, str]]:
    """Exit code, output and errors of Python processes that run at the same time."""
    fast = {
        "JAX_PLATFORMS": "cpu",
        "XLA_FLAGS": "--xla_backend_optimization_level=0",
        "OMP_NUM_THREADS": "1",
        "KOALA_CACHE": str(cache),
    }
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")} | fast
    begun = [
        subprocess.Popen([sys.executable, *command], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for command in commands
    ]
    deadline, ended = time.monotonic() + PATIENCE_S, []
    try:
        for process in begun:
            out, err = process.communicate(timeout=max(1.0, deadline - time.monotonic()))
            ended.append((process.returncode, out, err))
    finally:
        for process in begun:
            process.kill()
    return ended


@pytest.mark.timeout(900)
def test_processes_agree(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "run.json").write_text("{}")
    address = f"127.0.0.1:{free_port()}"
    ended = together([["-c", TALK, str(process), address, str(tmp_path)] for process in range(2)], tmp_path / "cache")
    assert [code for code, _, _ in ended] == [0, 0], [err[-2000:] for _, _, err in ended]
    first, second = (json.loads(out.partition("SAID")[2]) for _, out, _ in ended)
    assert (first["writes"], second["writes"], first["devices"]) == (True, False, 2)
    assert first["gathered"] == second["gathered"] == [[1 / 3, 2.0**60 + 256], [4 / 3, 2.0**60 + 256]], "to the last bit"
    assert first["decided"] == second["decided"] == 0.1 and first["text"] == second["text"] == "für alle"
    assert first["own"] == second["own"] == [0, 2, 4, 6, 8, 10]
    for said, taken in ((first, "taken: already exists"), (second, "process 0 could not begin")):
        assert [complaint for complaint in said["complaints"] if "process 1 has another scene than the first" in complaint]
        assert taken in said["complaints"][1] and "is not a run" in said["complaints"][2] and len(said["complaints"]) == 3
    assert first["own folder"] and not second["own folder"] and first["copied"] == second["copied"] == "0"
    assert first["left"] and not second["left"] and (tmp_path / "new" / "log").read_text() == "0", "only the first one's stays"


@pytest.mark.timeout(900)
@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_each_process_holds_and_does_its_share(count: int, tmp_path: Path) -> None:
    """Pixels, rays, samples and operations of one process, against those of one that is alone; and the same batch, to the bit."""
    address = f"127.0.0.1:{free_port()}"
    commands = [["-c", WORK, str(count), str(process), address] for process in range(count)]
    ended = together([*commands, ["-c", WORK, "1", "0", ""]], tmp_path / "cache")
    assert [code for code, _, _ in ended] == [0] * (count + 1), [err[-2000:] for _, _, err in ended]
    *several, alone = (json.loads(out.partition("SAID")[2]) for _, out, _ in ended)
    assert alone["pixels"] == [9999] * 3 and (alone["rays"], alone["samples"]) == (1024, 8192)
    for said in several:
        assert said["pixels"] == [-(-9999 // count)] * 3, "9999 and what fills them up"
        assert (said["rays"], said["samples"]) == (1024 // count, 8192 // count)
        assert said["digest"] == alone["digest"]
    assert several[0]["operations"] < 1.15 / count * alone["operations"], "what does not depend on the batch is done by each"
    assert several[0]["gathered"] <= 24 * 1024, "of others a process gets what their rays are; pixels would be 30,000 numbers"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_processes_come_to_what_one_comes_to(ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    """Sums over devices come in another order; Adam makes of a rounding's sign a step: 0.1 % of terms, 0.001 of weights."""
    train = ["-c", COMMAND, "train", str(ball_scene[1]), "--json", *(word for change in SMALL for word in ("--set", change))]
    address = f"127.0.0.1:{free_port()}"
    several = [*train, "--out", str(tmp_path / "two"), "--coordinator", address, "--processes", "2", "--process"]
    ended = together([[*several, "0"], [*several, "1"], [*train, "--out", str(tmp_path / "one")]], tmp_path / "cache")
    assert [code for code, _, _ in ended] == [0, 0, 0], [err[-2000:] for _, _, err in ended]
    results = [json.loads(out.strip().splitlines()[-1]) for _, out, _ in ended]
    assert [result["steps"] for result in results] == [3, 3, 3]
    one, two = (Run.open(tmp_path / name) for name in ("one", "two"))
    assert (one.content["devices"], two.content["devices"]) == (1, 2)
    assert len(one.log()) == len(two.log()) and two.log()[-1]["terms"] == pytest.approx(one.log()[-1]["terms"], rel=1e-3)
    leaves = []
    for run in (one, two):
        like = Model.create(jax.random.key(0), run.config, run.facts)
        leaves.append(jax.tree.leaves(checkpoint.load_model(run.path / CHECKPOINTS, like)[0].split()[0]))
    for alone, divided in zip(*leaves, strict=True):
        np.testing.assert_allclose(divided, alone, atol=1e-3)
    assert not [path for path in tmp_path.iterdir() if path.name not in ("one", "two", "cache")]


def test_one_process_talks_to_nobody(tmp_path: Path) -> None:
    distributed.join(None, None, None)
    assert distributed.writes() and distributed.gathered([1.0, 2.0]).tolist() == [[1.0, 2.0]]
    assert distributed.decided(0.1) == 0.1 and distributed.decided_text("ü") == "ü"
    distributed.require_same({"a": jnp.ones(3)}, "scene")
    with distributed.folder_for(tmp_path / "run") as folder:
        assert folder == tmp_path / "run"
    np.testing.assert_array_equal(distributed.own_copy({"a": jnp.ones(3), "b": None})["a"], np.ones(3))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("127.0.0.1:80", None, None), "give --coordinator, --processes and --process together"),
        ((None, 2, 0), "give --coordinator, --processes and --process together"),
        (("127.0.0.1", 2, 0), "is not HOST:PORT"),
        (("host:0", 2, 0), "is not HOST:PORT"),
        ((":80", 2, 0), "is not HOST:PORT"),
        (("127.0.0.1:80", 2, 2), "there is no process 2 of 2"),
    ],
)
def test_impossible_groups_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        distributed.join(*arguments)


def test_a_port_that_is_taken_and_a_process_that_is_not_there_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distributed, "JOIN_S", 0.3)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        with pytest.raises(UsageError, match=r"the first process cannot listen there.*choose another port"):
            distributed.join(f"127.0.0.1:{listener.getsockname()[1]}", 2, 0)
    with pytest.raises(ReconstructError, match="the first process cannot be reached"):
        distributed.join(f"127.0.0.1:{free_port()}", 2, 1)


def test_devices_of_several_processes_must_divide_every_batch(capsys: pytest.CaptureFixture[str]) -> None:
    class Device:
        def __init__(self, process_index: int) -> None:
            self.process_index = process_index

    with pytest.raises(UsageError, match="3 devices do not divide a batch evenly"):
        Division.among([Device(process) for process in range(3)], (2048, 8192))
    assert Division.among([Device(0)] * 3, (2048, 8192)).mesh is None, "one process leaves devices out"
    assert "1 of 3 devices are used" in capsys.readouterr().err
