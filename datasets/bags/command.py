"""A bag in the place of a recording on a command line, with a progress bar."""

from pathlib import Path

from koala3d.datasets.core import console


def opened(path: Path) -> Path:
    """The folder of a recording, that which is made of a ROS bag included. Raises as `recorded.recording_of` does."""
    from koala3d.datasets.bags.reading import is_bag
    from koala3d.datasets.bags.recorded import recording_of

    if not is_bag(path):
        return path
    with console.progress("reading the bag", 1, "messages") as bar:
        return recording_of(path, bar.show)
