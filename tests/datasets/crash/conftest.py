"""The modules of this folder import each other by name, as programs that strace starts do."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
