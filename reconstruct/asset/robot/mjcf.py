"""MJCF, MuJoCo's own format (mujoco.readthedocs.io, XML reference): a free body, and a scene in which it stands on a table."""

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element, SubElement

from koala3d.reconstruct.asset.robot.body import Body
from koala3d.reconstruct.asset.robot.urdf import ENTRIES, document, numbers

FILE, SCENE = "object.xml", "scene.xml"
LAYERS = {"rgb": "base_colour", "normal": "normal", "occlusion": "occlusion", "roughness": "roughness", "metallic": "metallic"}
"""MuJoCo's name of each texture's role: ours."""
ORDER = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")  # of `fullinertia`
SEEN, TOUCHED = "2", "3"  # groups of geometries that are drawn, and that viewers hide


def text(body: Body, name: str, visual: str, parts: Sequence[str], textures: Mapping[str, str]) -> str:
    """The file's text; arguments as for `urdf.text`, and the texture files by channel."""
    model = Element("mujoco", model=name)
    assets, world = SubElement(model, "asset"), SubElement(model, "worldbody")
    material = Element("material", name=f"{name}_surface")
    for role, channel in LAYERS.items():
        space = "sRGB" if role == "rgb" else "linear"
        SubElement(assets, "texture", name=f"{name}_{channel}", type="2d", file=textures[channel], colorspace=space)
        SubElement(material, "layer", role=role, texture=f"{name}_{channel}")
    assets.append(material)
    SubElement(assets, "mesh", name=f"{name}_visual", file=visual, inertia="shell")  # it may be open, and weighs nothing
    for number, part in enumerate(parts):
        SubElement(assets, "mesh", name=f"{name}_{number}", file=part)
    found = SubElement(world, "body", name=name)
    SubElement(found, "freejoint", name=name)
    full = numbers([body.inertia.tensor[ENTRIES[key]] for key in ORDER])
    SubElement(found, "inertial", pos=numbers(body.inertia.centre), mass=numbers([body.inertia.mass]), fullinertia=full)
    ghost = {"contype": "0", "conaffinity": "0", "group": SEEN, "material": f"{name}_surface"}
    SubElement(found, "geom", type="mesh", mesh=f"{name}_visual", **ghost)
    for number in range(len(parts)):
        SubElement(found, "geom", type="mesh", mesh=f"{name}_{number}", group=TOUCHED)
    return document(model)


def scene() -> str:
    """A scene with the body on a table and a lamp above it."""
    model = Element("mujoco", model="scene")
    SubElement(model, "include", file=FILE)
    world = SubElement(model, "worldbody")
    SubElement(world, "light", pos="0 0 2", dir="0 0 -1")
    SubElement(world, "geom", name="table", type="plane", size="1 1 0.1")
    return document(model)
