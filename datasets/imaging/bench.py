"""Time and memory needed to read images and shrink them."""

import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from datasets.imaging import downscale, images


def read_and_shrink(
    count: int = 50, *, width: int = 1920, height: int = 1080, factor: int = 4, suffix: str = ".png"
) -> dict[str, float]:
    """Read `count` images and shrink them, two at a time.

    The images are smooth with one grey level of noise, so that decoding costs as much as for photographs.

    Returns:
        `seconds` and `seconds_per_image` of wall time, `cpu_seconds` of all cores, `peak_growth_mb` of memory after the first ten
        images (0 where memory does not grow with their number), and what was read.
    """
    random = np.random.default_rng(0)
    columns, rows = np.meshgrid(np.linspace(0, 9, width), np.linspace(0, 7, height))
    smooth = 0.5 + 0.4 * np.sin(columns[..., None] + [0, 1, 2]) * np.cos(rows[..., None] * 1.3)
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for number in range(4):  # a few different files, read in turn
            paths.append(Path(folder) / f"{number}{suffix}")
            images.write(paths[-1], smooth + random.normal(0, 1 / 255, smooth.shape))
        megabytes = sum(path.stat().st_size for path in paths) / len(paths) / 1e6

        def shrink(path: Path) -> np.ndarray:
            return downscale.shrunk(path, width // factor, height // factor)

        target = shrink(paths[0])  # loads the libraries
        start, start_cpu, settled = time.perf_counter(), time.process_time(), 0
        for number, target in enumerate(downscale.streamed(shrink, (paths[i % len(paths)] for i in range(count)))):  # noqa: B007
            if number == min(9, count - 1):
                settled = _peak_kb()
        seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - start_cpu
    read = {"images": count, "width": width, "height": height, "factor": factor, "file_mb": megabytes}
    small = {"small_width": target.shape[1], "small_height": target.shape[0]}
    times = {"seconds": seconds, "cpu_seconds": cpu_seconds, "seconds_per_image": seconds / count}
    return {**read, **times, "peak_growth_mb": (_peak_kb() - settled) / 1e3, **small}


def _peak_kb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
