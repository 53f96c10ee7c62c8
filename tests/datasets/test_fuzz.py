"""Corrupted inputs end in one clear line: soon, in little memory, and without a look outside their folder."""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

SECONDS, BYTES = 2.0, 500 * 2**20
ALL, SHARE = 2000, 19


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="memory and opened files are watched through Linux")
@pytest.mark.parametrize("step", [pytest.param(SHARE, id="some"), pytest.param(1, id="all", marks=[pytest.mark.slow])])
@pytest.mark.timeout(1800)
def test_corrupted_inputs_are_refused(tmp_path: Path, step: int) -> None:
    program = Path(__file__).with_name("fuzz") / "program.py"
    done = subprocess.run([sys.executable, str(program), str(tmp_path), "0", str(ALL), str(step)], capture_output=True, text=True,
                          env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False)  # fmt: skip
    results = [json.loads(line) for line in done.stdout.splitlines()]
    numbers = [result["number"] for result in results]
    assert numbers == list(range(0, ALL, step)), f"the interpreter died after {numbers[-1:]}: {done.stderr[-500:]}"

    def wrong(condition) -> list[tuple]:
        return [(r["number"], r["kind"], r["way"], r["message"]) for r in results if condition(r)]

    assert not wrong(lambda r: r["outcome"] == "escaped")  # anything but an error of ours
    assert not wrong(lambda r: r["must_fail"] and r["outcome"] != "refused")
    assert not wrong(lambda r: r["outcome"] == "refused" and (r["lines"] != 1 or len(r["message"]) < 20))
    assert not wrong(lambda r: r["opened"])  # a file outside the folder
    assert not wrong(lambda r: r["events"])  # a program, a library or a pickle
    assert not wrong(lambda r: r["seconds"] > SECONDS)  # of processor time, so that a busy machine does not matter
    assert not wrong(lambda r: r["bytes"] > BYTES)
    refused = Counter(r["outcome"] for r in results)["refused"]
    assert refused > 0.75 * len(results)  # the premise: most corruptions matter; the rest hit what nobody reads
    assert len({r["way"] for r in results}) >= 18 and len({r["kind"] for r in results}) == 14  # and they are of many kinds
