"""What a file of Rerun's viewer holds, read by Rerun's own reader."""

import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

Logged = dict[str, list[tuple[Any, list[Any]]]]
"""(time, values) in the order of time, by "/entity Archetype:field". The time is None for what always holds."""


def read(path: Path, timeline: str) -> Logged:
    """All that is logged on a timeline. Rerun's own check finds nothing wrong with the file."""
    pytest.importorskip("rerun", reason="rerun-sdk is absent: pip install 'koala-capture[rerun]'")
    from rerun.chunk import RrdReader

    verified = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", path], capture_output=True, text=True)
    assert verified.returncode == 0, verified.stderr
    found: Logged = defaultdict(list)
    for chunk in RrdReader(path).stream():
        rows = chunk.to_record_batch().to_pydict()
        times = rows.get(timeline) or [None] * chunk.num_rows
        for name, values in rows.items():
            if ":" in name:
                found[f"{chunk.entity_path} {name}"] += [(t, v) for t, v in zip(times, values, strict=True) if v is not None]
    for values in found.values():
        values.sort(key=lambda one: (one[0] is not None, one[0]))
    return dict(found)
