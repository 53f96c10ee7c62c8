"""A real Ray cluster on this machine, whose workers can be killed and whose nodes can be taken away."""

import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.moments import until

cluster_utils = pytest.importorskip("ray.cluster_utils", reason="Ray is absent: pip install 'koala-capture[sweep]'")
if sys.platform != "linux":
    pytest.skip("processes are looked up in /proc", allow_module_level=True)

from koala3d.reconstruct.experiments import on_ray as on_ray  # noqa: E402

ROOT = Path(__file__).parents[2]
NODE = {"num_cpus": 1, "object_store_memory": 100 * 2**20, "include_dashboard": False}
FOLDER = "RAY_TMPDIR"
"""Variable with the folder for the files of a cluster."""


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A node with one processor. In the end none of its processes runs."""
    with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp") as folder, pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "PYTHONPATH": str(ROOT),  # workers import the jobs of these tests
            FOLDER: folder,  # short: paths of sockets have 107 characters at most
            "RAY_AUTH_MODE": "disabled",  # or it leaves a token in the user's home
            "RAY_USAGE_STATS_ENABLED": "0",
        }.items():
            patch.setenv(name, value)
        cluster = cluster_utils.Cluster(initialize_head=True, head_node_args=NODE)
        patch.setenv("RAY_ADDRESS", cluster.address)
        yield cluster
        cluster.shutdown()
        until(lambda: not started_with(folder), "the end of the cluster's processes")


def started_with(folder: str) -> list[str]:
    """Command lines of the processes that have the folder as `FOLDER` in their environment."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if f"{FOLDER}={folder}".encode() in (place / "environ").read_bytes().split(b"\0"):
                found.append((place / "cmdline").read_text().replace("\0", " "))
    return [line for line in found if "resource_tracker" not in line]  # that of this process, which runs jobs in processes, too


def workers(log: Path) -> list[int]:
    """The processes that have written to a log, oldest first."""
    return [int(number) for number in re.findall(r"^process (\d+) ", log.read_text(), re.MULTILINE)]
