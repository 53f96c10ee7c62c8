"""Chooses the variant of Mitsuba: the vectorised one if it works, otherwise the scalar one, which always works.

The vectorised variant takes a third of the time but needs a system LLVM, and some versions of LLVM crash the process on
some processors. A child process therefore tries it first. Version 19 is known to work (Debian and Ubuntu: `libllvm19`).
`DRJIT_LIBLLVM_PATH` sets the path of the library, `KOALA_RENDERER` the variant.
"""

import logging
import os
import subprocess
import sys
from functools import cache

FAST, SURE = "llvm_ad_rgb", "scalar_rgb"
TRIAL_S = 60.0  # time limit of the trial
_log = logging.getLogger(__name__)


@cache
def variant() -> str:
    """The fastest variant of Mitsuba that passes a trial in a child process; warns if that is the slow one."""
    asked = os.environ.get("KOALA_RENDERER", "")
    if asked in (FAST, SURE):
        return asked
    trial = [sys.executable, "-m", "capture.sim.laboratory.renderer_trial", FAST]
    try:
        done = subprocess.run(trial, capture_output=True, timeout=TRIAL_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        done = None
    if done is not None and done.returncode == 0:
        return FAST
    _log.warning("pictures are rendered without LLVM, which takes three times as long: install libllvm19, see docs/capture.md")
    return SURE
