"""Limits are rates of this machine; kernels are laid against them."""

import re

import pytest

from koala3d.reconstruct.bench import context
from koala3d.reconstruct.bench.cost import kernels, machine
from koala3d.reconstruct.bench.cost.kernels import Kernel
from koala3d.reconstruct.bench.cost.machine import Limit

LIMITS = [Limit("matrix", 1e11, "1/s", ""), Limit("exponential", 1e9, "1/s", ""), Limit("stream", 1e10, "B/s", ""),
          Limit("gather, in the cache", 1e9, "1/s", ""), Limit("scatter, in the cache", 5e8, "1/s", "")]  # fmt: skip


def test_rates_are_of_the_right_order() -> None:
    assert 1e8 < machine.matrix_rate(256).rate < 1e15
    assert 1e7 < machine.stream_rate(2**16).rate < 1e14
    assert 1e-7 < machine.dispatch_time().rate < 1e-2
    assert (
        machine.scaled(9.3e10, "1/s") == "93 G/s"
        and machine.scaled(2.1e10, "B/s") == "21 GB/s"
        and machine.scaled(6e-6, "s") == "6 us"
    )


def test_the_slowest_limit_binds() -> None:
    kernel = Kernel("encoding", 4096, operations=2e8, exponentials=0, bytes=1e6, gathers=4e6, scatters=1e6, seconds=8e-3)
    least, name = kernel.least({limit.name: limit.rate for limit in LIMITS})
    assert name == "gather, in the cache" and least == pytest.approx(4e-3)
    (row,) = kernels.rows([kernel], LIMITS)
    assert row["share"] == pytest.approx(0.5) and row["gathers"] == pytest.approx(4e6 / 4096)
    assert "50 %" in kernels.text([row])


def test_where_it_was_measured() -> None:
    about = context.describe()
    assert about["cores"] >= 1 and about["memory_gb"] > 0.1 and about["machine"]
    assert re.fullmatch(r"([0-9a-f]{4,}\+?)?", about["commit"])
    assert about["when"].endswith("+00:00")
