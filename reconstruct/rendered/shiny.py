"""Five shiny scenes whose shape is known exactly. Frozen: whoever changes their images raises `EDITION`.

Each lies inside a ball of 0.12 m about the origin, in front of a white background. Cameras surround it, some a little below.
"""

from collections.abc import Callable

from koala3d.reconstruct.rendered.light import Light
from koala3d.reconstruct.rendered.solids import ball, blended, block, placed, puck, rod, torus
from koala3d.reconstruct.rendered.tracer import Body, Material, Tracer

EDITION = 1
RADIUS_M = 0.12  # radius of the ball that contains each scene [m]: the tracer's unit
CHROME = Material((0.0, 0.0, 0.0), (0.88, 0.88, 0.90), 400.0)
GOLD = Material((0.03, 0.02, 0.005), (0.95, 0.70, 0.28), 150.0)
ROUGH_COPPER = Material((0.05, 0.025, 0.015), (0.85, 0.50, 0.36), 25.0)
PORCELAIN = Material((0.62, 0.60, 0.56), (0.05, 0.05, 0.05), 500.0)
RED_LACQUER = Material((0.42, 0.03, 0.02), (0.10, 0.10, 0.10), 250.0)
CHEQUERED = Material((0.55, 0.45, 0.12), (0.08, 0.08, 0.08), 200.0, second=(0.05, 0.12, 0.35), patches=9.0)


def chrome_ball() -> Tracer:
    """A mirror that shows every direction of the light."""
    return Tracer((Body(ball(0.8), CHROME),), Light.studio(1))


def gold_rings() -> Tracer:
    """Two linked gold rings that reflect each other."""
    first = placed(torus(0.46, 0.17), (-0.22, 0.0, 0.0), (12, 0, 0))
    second = placed(torus(0.46, 0.17), (0.24, 0.0, 0.0), (98, 10, 0))
    return Tracer((Body(first, GOLD), Body(second, GOLD)), Light.studio(2))


def teapot() -> Tracer:
    """Glazed porcelain: bright, with faint sharp highlights. Belly, foot, spout, handle and knob are blended into one solid."""
    belly = placed(ball(0.5), (0.0, 0.0, -0.12))
    foot = placed(puck(0.3, 0.06, 0.04), (0.0, 0.0, -0.6))
    spout = rod((0.35, 0.0, -0.2), (0.8, 0.0, 0.22), 0.085)
    handle = placed(torus(0.27, 0.055), (-0.55, 0.0, -0.06), (90, 0, 0))
    knob = placed(ball(0.09), (0.0, 0.0, 0.46))
    return Tracer((Body(blended(0.16, belly, foot, spout, handle, knob), PORCELAIN),), Light.studio(3))


def lacquered_box() -> Tracer:
    """A chequered box with soft edges under a red lacquered puck: large flat faces, which reflect a small part of the light."""
    box = placed(block((0.54, 0.44, 0.38), 0.07), (0.0, 0.0, -0.34), (0, 0, 25))
    lid = placed(puck(0.48, 0.18, 0.09), (0.06, -0.03, 0.3), (14, 8, 0))
    return Tracer((Body(box, CHEQUERED), Body(lid, RED_LACQUER)), Light.studio(4))


def three_metals() -> Tracer:
    """Chrome, gold and rough copper side by side on a lacquered bar."""
    bar = placed(block((0.84, 0.28, 0.08), 0.06), (0.0, 0.0, -0.42))
    sphere = placed(ball(0.29), (-0.53, 0.0, -0.02))
    cube = placed(block((0.23, 0.23, 0.36), 0.09), (0.05, 0.0, 0.06), (0, 0, 35))
    ring = placed(torus(0.23, 0.1), (0.58, 0.0, 0.02), (90, 0, 30))
    return Tracer((Body(bar, RED_LACQUER), Body(sphere, CHROME), Body(cube, ROUGH_COPPER), Body(ring, GOLD)), Light.studio(5))


_MADE = (chrome_ball, gold_rings, teapot, lacquered_box, three_metals)
SCENES: dict[str, Callable[[], Tracer]] = {made.__name__: made for made in _MADE}
