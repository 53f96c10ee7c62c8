"""Optional dependencies: which extra installs a module that is missing."""

from koala3d.datasets.core.errors import KoalaError

EXTRAS = {
    "pypylon": "robot",
    "rtde_control": "robot",
    "rtde_receive": "robot",
    "mitsuba": "sim",
    "viser": "view",
    "tensorboardX": "tensorboard",
    "ray": "sweep",
    "xatlas": "asset",
    "pxr": "asset",
    "coacd": "asset",
    "rerun": "rerun",
    "harvesters": "genicam",
    "genicam": "genicam",
    "pyrealsense2": "realsense",
    "gphoto2": "gphoto2",
    "rosbags": "ros",
}
"""Module to the extra of pyproject.toml that brings it."""


class NotInstalled(KoalaError):
    """A package that this command needs is not installed."""

    exit_code = 1


def not_installed(error: ModuleNotFoundError) -> NotInstalled | None:
    """What to install for a failed import; None where the module is none of our optional dependencies."""
    module = (error.name or "").split(".")[0]
    if module == "pycolmap":
        why, remedy = "it has wheels for Linux x86-64 and macOS ARM only", "run this command on such a machine"
        return NotInstalled("pycolmap is not installed", why=why, remedy=f"{remedy}; everything else works without it")
    if module not in EXTRAS:
        return None
    return NotInstalled(f"{module} is not installed", remedy=f"pip install 'koala-capture[{EXTRAS[module]}]'")
