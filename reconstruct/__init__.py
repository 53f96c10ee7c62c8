"""Train Surf-NeRF on a scene, measure it, and take geometry and appearance out of it."""

import os
from pathlib import Path

_KEEP_BARRIERS = "--xla_disable_hlo_passes=cse_barrier_expander"

if _KEEP_BARRIERS not in os.environ.get("XLA_FLAGS", "") and not Path("/dev/nvidiactl").exists():
    # On the CPU the compiler drops optimisation barriers before it fuses, and then recomputes the simplex search inside
    # each of the gathers that use it: a training step takes 390 ms instead of 28. Read when the first array is made.
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_KEEP_BARRIERS}".strip()
