"""Tries corrupted inputs in several processes and judges what became of each.

    python pool.py COUNT [--step N] [--workers N] [--failures FILE]

An input must be read or refused in one clear line, in less than 2 s of processor time and 500 MB, without touching anything
outside its folder. `--failures` gets one line for each that was not: "number kind way: what". The same number is the same input:
`PYTHONPATH=. python tests/fuzz/program.py FOLDER NUMBER NUMBER+1 1` repeats it.
"""

import argparse
import json
import os
import selectors
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from pathlib import Path
from typing import Any

SECONDS, BYTES = 2.0, 500 * 2**20
PATIENCE_S = 30.0
"""After so long without a word a process hangs, however busy the computer is."""
START_S = 240.0
"""The same while it starts."""
PROGRAM = Path(__file__).with_name("program.py")


def faults(result: dict[str, Any]) -> list[str]:
    """What is wrong with what became of one input; empty: nothing."""
    found, outcome, message = [], result["outcome"], result["message"]
    if outcome == "died":
        found.append(f"the process {message}")
    if outcome == "raised":
        found.append(f"raised {message}")
    if outcome == "refused" and (result["lines"] != 1 or len(message) < 20):
        found.append(f"the refusal is not one clear line: {message!r}")
    if outcome == "refused" and "MemoryError" in message:
        found.append(f"refused only when memory ran out: {message}")
    if result["must_fail"] and outcome == "read":
        found.append("was read, and must be refused")
    found += result["strange"]
    if result["seconds"] > SECONDS:
        found.append(f"took {result['seconds']:.1f} s")
    if result["bytes"] > BYTES:
        found.append(f"took {result['bytes'] / 2**20:.0f} MB")
    return [" ".join(words.split()) for words in found]


def attempt(numbers: range, folder: Path, results: list[dict[str, Any]]) -> None:
    """Try a range of inputs in one process after another: one that dies or hangs is replaced, its input judged."""
    while numbers:
        folder.mkdir()
        scratch = folder / "tmp"
        scratch.mkdir()
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu", "TMPDIR": str(scratch)}
        environment |= {"KOALA_CACHE": str(folder / "cache"), "PYTHONPATH": str(PROGRAM.parent.parent.parent)}
        words = [sys.executable, str(PROGRAM), str(folder), *map(str, (numbers.start, numbers.stop, numbers.step))]
        with (
            tempfile.TemporaryFile() as errors,
            subprocess.Popen(words, stdout=subprocess.PIPE, stderr=errors, env=environment) as process,
        ):
            begun, done, reason = _follow(process, results)
            errors.seek(0)
            last = errors.read().decode(errors="replace").strip()[-300:]
        folder = folder.with_name(folder.name + "+")
        if begun is None and done is None:
            raise RuntimeError(f"program.py did not start: {reason} {last}")
        if begun is not None and begun["number"] != done:
            lost = {
                **begun,
                "must_fail": False,
                "outcome": "died",
                "message": f"{reason} {last}",
                "lines": 1,
                "seconds": 0.0,
                "bytes": 0,
            }
            results.append({**lost, "strange": []})
            done = begun["number"]
        numbers = numbers[numbers.index(done) + 1 :] if done is not None else range(0)


def _follow(process: "subprocess.Popen[bytes]", results: list[dict[str, Any]]) -> tuple[dict[str, Any] | None, int | None, str]:
    """Collect results until the process ends; kills it where it is silent. Returns the last input begun, the number of the last
    one done, and how the process ended."""
    assert process.stdout is not None
    begun, done, patience = None, None, START_S
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while selector.select(patience):
            line = process.stdout.readline()
            if not line:
                return begun, done, f"ended with {process.wait()}"
            result, patience = json.loads(line), PATIENCE_S
            if "outcome" in result:
                results.append(result)
                done = result["number"]
            else:
                begun = result
    process.kill()
    return begun, done, f"was silent for {patience:.0f} s"


def run(numbers: range, workers: int) -> list[dict[str, Any]]:
    """What became of a range of inputs, by number."""
    results: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="koala-fuzz-") as scratch:
        shares = [numbers[index::workers] for index in range(workers)]
        threads = [
            threading.Thread(target=attempt, args=(share, Path(scratch) / f"{index}", results))
            for index, share in enumerate(shares)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return sorted(results, key=lambda result: result["number"])


def summary(results: list[dict[str, Any]]) -> str:
    """A few lines on all results."""
    outcomes, kinds = Counter(r["outcome"] for r in results), Counter(r["kind"] for r in results)
    slowest, largest = max(r["seconds"] for r in results), max(r["bytes"] for r in results) / 2**20
    words = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    return f"{len(results)} inputs of {len(kinds)} kinds: {words}; at most {slowest:.2f} s and {largest:.0f} MB"


def main() -> int:
    """The command line; 1 where an input found a fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--step", type=int, default=1)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--failures", type=Path, default=Path("build/fuzz/failures.txt"))
    parser.add_argument("--json", action="store_true", help="print every result as one line of JSON instead")
    options = parser.parse_args()
    results = run(range(0, options.count, options.step), options.workers)
    if options.json:
        for result in results:
            print(json.dumps({**result, "faults": faults(result)}))
        return 0
    lines = [f"{r['number']} {r['kind']} {r['way']}: {'; '.join(faults(r))}" for r in results if faults(r)]
    options.failures.parent.mkdir(parents=True, exist_ok=True)
    options.failures.write_text("".join(f"{line}\n" for line in lines), errors="replace")
    print(f"{summary(results)}; {len(lines)} faults{f', listed in {options.failures}' if lines else ''}")
    return 1 if lines or len(results) != len(range(0, options.count, options.step)) else 0


if __name__ == "__main__":
    sys.exit(main())
