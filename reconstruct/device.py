"""What JAX computes on, and whether compiled kernels run there."""

from typing import Any


def found() -> dict[str, Any]:
    """What JAX computes on, whether compiled kernels run there, and a line that says so."""
    import jax

    from koala3d.reconstruct.kernels import native

    devices, why_not = jax.devices(), native.why_not()
    where = f"{len(devices)} x {devices[0].device_kind}" if len(devices) > 1 else devices[0].device_kind
    text = f"{where}: compiled kernels" if why_not is None else f"{where}: plain JAX, for {why_not}"
    if why_not is not None and devices[0].platform == "cpu":
        text += "; a training step takes 1.5 to 2 times as long as with compiled kernels"
    return {
        "platform": devices[0].platform,
        "devices": len(devices),
        "kernels": why_not is None,
        "why_not": why_not,
        "text": text,
    }
