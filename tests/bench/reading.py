"""Time and memory needed to read images and shrink them."""

import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from koala3d.datasets.imaging import downscale, images, reduced
from koala3d.datasets.imaging.copies import Copies


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


def read_photographs(count: int = 57, *, width: int = 4608, height: int = 3456, scale: float = 0.1) -> dict[str, float]:
    """Read `count` JPEGs at `scale`, `READERS` at a time: by OpenCV alone, from the files, and from their copies.

    OpenCV decodes whole pictures and averages sRGB values; we average light. The pictures have detail of all widths down to three
    pixels, of more contrast than photographs have.

    Returns:
        `opencv_seconds`, `seconds` and `again_seconds` of wall time, and `cpu_seconds` likewise; `file_mb`; and for one picture
        `largest_difference` and `mean_difference` [steps of 255] from decoding all pixels and averaging their light.
    """
    wide, high = max(1, round(width * scale)), max(1, round(height * scale))
    with tempfile.TemporaryDirectory() as folder:
        first = _photograph(Path(folder) / "0.jpg", width, height)
        paths = [first, *(Path(shutil.copy(first, first.with_stem(f"{i}"))) for i in range(1, count))]
        copies = Copies(Path(folder) / "copies")

        def kept(path: Path) -> np.ndarray:
            return np.array(copies.of([path], wide, high, lambda: reduced.read_resized(path, None, wide, high)))

        def plainly(path: Path) -> np.ndarray:
            pixels = cv2.imread(str(path))
            assert pixels is not None, "it was written above"
            return cv2.resize(pixels, (wide, high), interpolation=cv2.INTER_AREA)

        times: dict[str, float] = {}
        for name, read in {"opencv_": plainly, "": kept, "again_": kept}.items():
            times[f"{name}seconds"], times[f"{name}cpu_seconds"] = _seconds(read, paths)
        exact = images.resize(images.read(first), wide, high)
        off = 255 * np.abs(images.as_float(reduced.read_resized(first, None, wide, high)) - exact)
        megabytes = first.stat().st_size / 1e6
    sizes = {"images": count, "width": width, "height": height, "small_width": wide, "small_height": high, "file_mb": megabytes}
    return {**sizes, **times, "largest_difference": float(off.max()), "mean_difference": float(off.mean())}


def _photograph(path: Path, width: int, height: int) -> Path:
    """Write a JPEG with random detail of widths from three to 96 pixels."""
    random, picture = np.random.default_rng(0), np.full((height, width, 3), 0.5, np.float32)
    for detail in (3, 12, 96):
        coarse = random.normal(0, 0.12, (-(-height // detail), -(-width // detail), 3)).astype(np.float32)
        picture += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(path), images.to_uint8(picture), [cv2.IMWRITE_JPEG_QUALITY, 92])
    return path


def _seconds(read: Callable[[Path], np.ndarray], paths: list[Path]) -> tuple[float, float]:
    """Wall-clock and processor time."""
    start, start_cpu = time.perf_counter(), time.process_time()
    for _ in downscale.streamed(read, paths, workers=reduced.READERS):
        pass
    return time.perf_counter() - start, time.process_time() - start_cpu


def main(
    count: Annotated[int, typer.Option(help="Number of photographs of 16 megapixels.", min=1)] = 57,
    scale: Annotated[float, typer.Option(help="Share of their size at which they are read.", min=0.001, max=1.0)] = 0.1,
    shrink: Annotated[bool, typer.Option("--shrink", help="Read pictures of 1920x1080 and shrink them by four instead.")] = False,
    suffix: Annotated[str, typer.Option(help="Format of these: .png, .jpg, .tif or .exr.")] = ".png",
) -> None:
    """Measure how long it takes to read photographs at a smaller size, as training does, and compare it with OpenCV."""
    found = read_and_shrink(count, suffix=suffix) if shrink else read_photographs(count, scale=scale)
    print("\n".join(f"{name:<20}{value:.3f}" for name, value in found.items()))


if __name__ == "__main__":
    typer.run(main)
