"""Print as JSON what nerfstudio's own data parser makes of a folder; runs in nerfstudio's environment, without Koala.

python nerfstudio_reads.py FOLDER FACTOR
"""

import json
import sys
from pathlib import Path

import torch
from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig
from nerfstudio.data.datasets.base_dataset import InputDataset

PIXELS = torch.tensor([[3, 5], [12, 20], [11, 17]])  # row, column


def described(folder: Path, factor: int, split: str) -> dict:
    """A split: names, sizes, means of the masks, and rays through the middle of `PIXELS` of its first view."""
    config = NerfstudioDataParserConfig(data=folder, downscale_factor=factor, load_3D_points=True)
    parsed = config.setup().get_dataparser_outputs(split=split)
    loaded = InputDataset(parsed)
    data = [loaded.get_data(index) for index in range(len(loaded))]
    rays = loaded.cameras.generate_rays(camera_indices=0, coords=PIXELS + 0.5)
    turn = parsed.dataparser_transform[:3, :3]
    origins = (rays.origins / parsed.dataparser_scale - parsed.dataparser_transform[:, 3]) @ turn
    return {
        "names": [path.name for path in parsed.image_filenames],
        "sizes": [list(item["image"].shape[:2]) for item in data],
        "cameras": torch.cat([loaded.cameras.height, loaded.cameras.width], -1).tolist(),
        "masks": [[list(item["mask"].shape[:2]), float(item["mask"].float().mean())] for item in data if "mask" in item],
        "origins": origins.tolist(),
        "directions": (rays.directions @ turn).tolist(),
        "points": (parsed.metadata["points3D_xyz"] / parsed.dataparser_scale - parsed.dataparser_transform[:, 3])
        .matmul(turn)
        .tolist()
        if "points3D_xyz" in parsed.metadata
        else None,
        "colours": parsed.metadata["points3D_rgb"].tolist() if "points3D_rgb" in parsed.metadata else None,
    }


if __name__ == "__main__":
    result = {split: described(Path(sys.argv[1]), int(sys.argv[2]), split) for split in ("train", "val", "test")}
    sys.stdout.write("\n" + json.dumps(result) + "\n")
