"""Shows splats in a viewer that has never seen the model: Spark, with three.js in Chromium.

    python docs/show_splats.py RUN SPLATS NODE_MODULES OUT.png [VIEW...]

Prints PSNR of the viewer's pictures and of the model's own against the photographs of all test views. Each row of the picture is
a test view: photograph, model, viewer. NODE_MODULES is the folder that `npm install three @sparkjsdev/spark` makes.
"""

import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from make_figures import chromium, run_program
from numpy.typing import NDArray
from show_asset import GAP, VIEWS, beside_each_other, by_three, window

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.output import metrics
from koala3d.reconstruct.output.evaluate import read_truth
from koala3d.reconstruct.output.trained_model import TrainedModel

Picture = NDArray[np.float32]
PAGE = """<!doctype html><meta charset="utf-8"><body style="margin:0;background:#fff">
<script type="importmap">{"imports": {"three": "/node/three/build/three.module.js",
  "three/addons/": "/node/three/examples/jsm/",
  "@sparkjsdev/spark": "/node/@sparkjsdev/spark/dist/spark.module.js"}}</script>
<script type="module">
import * as THREE from 'three';
import {SparkRenderer, SplatMesh} from '@sparkjsdev/spark';
const renderer = new THREE.WebGLRenderer({antialias: false, preserveDrawingBuffer: true});
renderer.setClearColor(0xffffff, 1);
document.body.appendChild(renderer.domElement);
const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera();
const spark = new SparkRenderer({renderer, autoUpdate: false});
camera.matrixAutoUpdate = false;
scene.add(spark);
async function load() {
  const splats = new SplatMesh({url: '/splats.SUFFIX'});
  await splats.initialized;
  scene.add(splats);
}
window.ready = load().then(() => 'loaded', error => String(error));
window.show = async (width, height, projection, place) => {
  renderer.setSize(width, height);
  camera.matrix.fromArray(place);
  camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
  camera.updateMatrixWorld(true);
  camera.projectionMatrix.fromArray(projection);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  for (let turn = 0; turn < 3; turn++) {
    await spark.update({scene, camera});
    renderer.render(scene, camera);
    while (spark.sorting || spark.sortDirty) await new Promise(done => setTimeout(done, 20));
  }
  renderer.render(scene, camera);
  return renderer.domElement.toDataURL('image/png');
};
</script>
"""


def main() -> None:
    """Write the picture; the last line names it."""
    if len(sys.argv) < 5:
        raise UsageError("give RUN SPLATS NODE_MODULES OUT.png", remedy="see the first lines of docs/show_splats.py")
    run, splats, node, out = map(Path, sys.argv[1:5])
    if not (node / "@sparkjsdev" / "spark" / "dist" / "spark.module.js").is_file():
        raise UsageError("Spark is not there", where=node, remedy="npm install three @sparkjsdev/spark, then give node_modules")
    trained = TrainedModel.open(run)
    views = trained.scene.split("test")
    chosen = [view for view in views if view.name in sys.argv[5:]] or views[:: max(1, len(views) // VIEWS)][:VIEWS]
    rows, measured = [], []
    with chromium() as browser, viewer(browser, splats, node) as page, console.progress("showing", len(views), "views") as bar:
        for view in views:
            photograph, pictures, found = compared(trained, view, page)
            measured.append(found)
            if view in chosen:
                rows.append(beside_each_other([photograph, *pictures]))
            bar.advance()
    images.write(out, np.concatenate(rows)[:-GAP, :-GAP])
    for name in measured[0]:
        model, viewed = np.mean([one[name] for one in measured], axis=0)
        console.hint(f"{name}: model {model:.2f} dB, viewer {viewed:.2f} dB")
    console.hint(str(out))


def compared(trained: TrainedModel, view: View, page: Any) -> tuple[Picture, tuple[Picture, Picture], dict[str, list[float]]]:
    """The photograph of a view, the pictures of model and viewer, and PSNR of both: of all pixels, and inside the object."""
    camera = trained.camera(view)
    truth = read_truth(view, camera, trained.run.copies)
    pictures = trained.picture(view).rgb, by_three(page, camera, view.world_from_camera)
    masks = {"psnr": None}
    if "alpha" in truth:
        masks |= {"psnr_inside": metrics.inside(truth["alpha"])}
    found = {name: [metrics.psnr(picture, truth["rgb"], mask) or 0.0 for picture in pictures] for name, mask in masks.items()}
    return truth["rgb"], pictures, found


def viewer(browser: Any, splats: Path, node: Path) -> AbstractContextManager[Any]:
    """A window that has loaded the splats."""
    content, served = PAGE.replace(".SUFFIX", splats.suffix), {f"splats{splats.suffix}": splats, "node": node}
    return window(browser, content, served, "Spark cannot show the splats", where=splats)


if __name__ == "__main__":
    run_program(main)
