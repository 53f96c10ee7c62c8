"""Corrupted inputs, each from its number alone, and what becomes of them; `pool.py` starts several of these.

    python program.py FOLDER FIRST LAST STEP

makes a small sound input of every kind in FOLDER, corrupts a copy of one of them for every number of the range, reads it
completely, and prints one JSON object per number before (what) and after (what became of it). A crash of the interpreter
ends the output, so nothing can hide.
"""

import json
import random
import resource
import shutil
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from damage import WAYS, Damage
from readers import read_all
from sound import sound_inputs
from watch import Watch, forget_peak, peak_bytes

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images

HEADROOM = 2**30
"""Address space beyond what a process needs anyway: the machine is not to suffer where a limit is missing [bytes]."""


def attempt(number: int, sources: dict[str, Path], work: Path, watch: Watch) -> dict[str, Any]:
    """Corrupt the input of one number and read it."""
    choice = random.Random(number)
    folder, out = work / "input" / "folder", work / "output" / "out"
    must_fail = None
    while must_fail is None:
        kind, way = choice.choice(sorted(sources)), choice.choice(WAYS)
        for used in (folder.parent, out.parent):
            shutil.rmtree(used, ignore_errors=True)
        shutil.copytree(sources[kind], folder)
        out.parent.mkdir()
        must_fail = getattr(Damage(folder, watch.folder, number), way)()
    print(json.dumps({"number": number, "kind": kind, "way": way}), flush=True)
    watch.refresh()
    before, start = forget_peak(), time.process_time()
    outcome, message = "read", ""
    try:
        read_all(kind, folder, out, number)
    except KoalaError as error:
        outcome, message = "refused", str(error)
    except BaseException as error:
        outcome, message = "raised", f"{type(error).__name__} in {_origin(error)}: {error}"
    seconds, memory = time.process_time() - start, peak_bytes() - before
    strange = watch.strange(allowed=(work / "input", out))
    return {
        "number": number,
        "kind": kind,
        "way": way,
        "must_fail": must_fail,
        "outcome": outcome,
        "message": message[:400],
        "lines": len(message.splitlines()),
        "seconds": seconds,
        "bytes": memory,
        "strange": strange,
    }


def _origin(error: BaseException) -> str:
    """Innermost function of Koala's in a traceback, with its file."""
    found, trace = "nowhere", error.__traceback__
    while trace is not None:
        path = Path(trace.tb_frame.f_code.co_filename)
        if path.parts and {"datasets", "calib", "capture", "reconstruct"} & set(path.parts) and "site-packages" not in path.parts:
            found = f"{path.parent.name}/{path.name}:{trace.tb_frame.f_code.co_name}"
        trace = trace.tb_next
    return found


def main(folder: Path, numbers: range) -> None:
    """Try every number of a range."""
    warnings.simplefilter("ignore")
    sources = sound_inputs(folder / "sound")
    work, outside = folder / "work", folder / "work" / "outside"
    outside.mkdir(parents=True)
    shutil.copy(folder / "sound" / "source" / "0.png", outside / "secret.png")
    for kind, path in sources.items():
        out = folder / "premise" / kind
        out.parent.mkdir(exist_ok=True)
        read_all(kind, path, out, 0)  # the premise: nothing is wrong with them; and all modules are loaded now
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + HEADROOM, used + HEADROOM))
    watch = Watch(work, outside)
    images.read(outside / "secret.png")
    assert watch.strange(allowed=())  # the premise: what a library of C++ opens is seen, too
    for number in numbers:
        print(json.dumps(attempt(number, sources, work, watch)), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), range(*map(int, sys.argv[2:5])))
