"""Shows an asset in two programs that have never seen the model: three.js in Chromium, and Mitsuba.

    python docs/show_asset.py RUN ASSET.glb LIGHT.exr THREE OUT.png [VIEW...]

Each row is a test view: the photograph, the model, the asset in Mitsuba, and the asset in three.js. THREE is the folder that
`npm install three` makes (node_modules/three).
"""

import base64
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from make_figures import PATIENCE_S, chromium, run_program
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import console
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.imaging import images
from koala3d.reconstruct.output.proof.proof import shown
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.path_tracing import reading
from koala3d.reconstruct.path_tracing.stage import Stage

Picture = NDArray[np.float32]

PATHS, VIEWS = 128, 3
FINER = 2  # three.js draws so many pixels for one of the photograph's, along each axis
GAP = 6
PAGE = """<!doctype html><meta charset="utf-8"><body style="margin:0;background:#fff">
<script type="importmap">{"imports": {"three": "/three/build/three.module.js", "addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from 'three';
import {GLTFLoader} from 'addons/loaders/GLTFLoader.js';
import {EXRLoader} from 'addons/loaders/EXRLoader.js';
const renderer = new THREE.WebGLRenderer({antialias: true, preserveDrawingBuffer: true});
document.body.appendChild(renderer.domElement);
const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera();
scene.background = new THREE.Color(1, 1, 1);
camera.matrixAutoUpdate = false;
async function load() {
  const light = await new EXRLoader().loadAsync('/light.exr');
  light.mapping = THREE.EquirectangularReflectionMapping;
  scene.environment = new THREE.PMREMGenerator(renderer).fromEquirectangular(light).texture;
  scene.add((await new GLTFLoader().loadAsync('/asset.glb')).scene);
}
window.ready = load().then(() => 'loaded', error => String(error));
window.show = (width, height, projection, place) => {
  renderer.setSize(width, height);
  camera.matrixWorld.fromArray(place);
  camera.matrixWorldInverse.copy(camera.matrixWorld).invert();
  camera.matrix.copy(camera.matrixWorld);
  camera.projectionMatrix.fromArray(projection);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  renderer.render(scene, camera);
  return renderer.domElement.toDataURL('image/png');
};
</script>
"""


class Quiet(SimpleHTTPRequestHandler):
    """Serves files without a line for each."""

    def log_message(self, *words: object) -> None:
        """Say nothing."""


def main() -> None:
    """Write the picture; the last line names it."""
    if len(sys.argv) < 6:
        raise UsageError("give RUN ASSET.glb LIGHT.exr THREE OUT.png", remedy="see the first lines of docs/show_asset.py")
    run, asset, light, three, out = map(Path, sys.argv[1:6])
    if not (three / "build" / "three.module.js").is_file():
        raise UsageError("this is not three.js", where=three, remedy="npm install three, then give node_modules/three")
    trained, stored = TrainedModel.open(run), reading.read(asset)
    views = trained.scene.split("test")
    if wanted := sys.argv[6:]:
        views = tuple(view for view in views if view.name in wanted)
    else:
        views = views[:: max(1, len(views) // VIEWS)][:VIEWS]
    stage, rows = Stage(stored, light), []
    with viewer(asset, light, three) as page:
        for view in views:
            one, camera = shown(trained, stage, view, paths=PATHS, seed=0), trained.camera(view)
            place = pose.inverse(stored.base_from_asset) @ view.world_from_camera
            pictures = [one.photograph, one.model, one.asset, by_three(page, camera, place)]
            rows.append(beside_each_other(pictures))
    images.write(out, np.concatenate(rows)[:-GAP, :-GAP])
    console.hint(str(out))


def beside_each_other(pictures: Sequence[Picture]) -> Picture:
    """A row of pictures, with a gap behind and below each."""
    return np.concatenate([np.pad(p, ((0, GAP), (0, GAP), (0, 0)), constant_values=1.0) for p in pictures], 1)


@contextmanager
def viewer(asset: Path, light: Path, three: Path) -> Iterator[Any]:
    """A browser that has loaded the asset and its light."""
    served = {"asset.glb": asset, "light.exr": light, "three": three}
    with chromium() as browser, window(browser, PAGE, served, "three.js cannot show the asset", where=asset) as page:
        yield page


@contextmanager
def window(browser: Any, content: str, served: dict[str, Path], failure: str, *, where: Path) -> Iterator[Any]:
    """A window with a page whose `ready` says that it is loaded.

    Args:
        content: the page.
        served: files and folders beside it, by name.
        failure: what went wrong if it is not, of the file `where`.
    """
    with TemporaryDirectory() as folder:
        for name, path in served.items():
            (Path(folder) / name).symlink_to(path.resolve())
        (Path(folder) / "index.html").write_text(content)
        server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            page = browser.new_page()
            page.set_default_timeout(1e3 * PATIENCE_S)
            page.goto(f"http://127.0.0.1:{server.server_port}/index.html")
            page.wait_for_function("window.ready")
            if (said := page.evaluate("window.ready")) != "loaded":
                raise KoalaError(failure, where=where, why=said)
            yield page
        finally:
            server.shutdown()


def by_three(page: Any, camera: Camera, asset_from_camera: NDArray[np.float64]) -> Picture:
    """(height, width, 3) sRGB of a view in three.js. The distortion of the lens is left out."""
    width, height = camera.width, camera.height
    place = asset_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL looks along -z, with y up
    arguments = [FINER * width, FINER * height, projection(camera).T.ravel().tolist(), place.T.ravel().tolist()]
    data = page.evaluate("([w, h, projection, place]) => window.show(w, h, projection, place)", arguments)
    encoded = np.frombuffer(base64.b64decode(data.split(",")[1]), np.uint8)
    fine = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR)[..., ::-1], np.float32) / 255
    return np.asarray(cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def projection(camera: Camera, near: float = 1e-3, far: float = 1e3) -> NDArray[np.float64]:
    """(4, 4) of OpenGL for a pinhole with any principal point."""
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = 2 * camera.fx / camera.width, 2 * camera.fy / camera.height
    matrix[0, 2], matrix[1, 2] = 1 - 2 * camera.cx / camera.width, 2 * camera.cy / camera.height - 1
    matrix[2, 2], matrix[2, 3] = (far + near) / (near - far), 2 * far * near / (near - far)
    matrix[3, 2] = -1.0
    return matrix


if __name__ == "__main__":
    run_program(main)
