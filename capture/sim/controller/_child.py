"""The process that is the simulated controller: `python -m koala3d.capture.sim.controller._child '{"seed": 0, ...}'`.

Prints {"host": ..., "side_port": ...} once all ports accept. Ends with standard input, so that it never outlives its parent.
"""

import asyncio
import errno
import json
import os
import random
import sys
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from koala3d.capture.drivers.ur.interfaces import robot_api
from koala3d.capture.model.arm import load_arm
from koala3d.capture.sim.controller import primary, side_channel
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.server import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT, ControllerServer
from koala3d.capture.sim.controller.session import CYCLE_HZ

ONLY_HOST = "127.0.0.1"  # the only loopback address that macOS has by default


def _random_host() -> str:
    return f"127.{random.randrange(1, 255)}.{random.randrange(1, 255)}.{random.randrange(1, 255)}"


async def _listen(server: ControllerServer, wanted: str) -> tuple[str, int]:
    """Open all ports on the address `wanted`, or on a free loopback address; returns it and the side channel's port."""
    handlers = {RTDE_PORT: server.serve_rtde, SCRIPT_PORT: server.serve_script, DASHBOARD_PORT: server.serve_dashboard}
    handlers |= dict.fromkeys(primary.PORTS, partial(primary.serve, server))
    ports = ", ".join(map(str, handlers))
    for host in [wanted] if wanted else [*(_random_host() for _ in range(50)), ONLY_HOST]:
        opened = []
        try:
            for port, handler in handlers.items():
                opened.append(await asyncio.start_server(handler, host, port))
            with suppress(OSError):  # most users may not open ports below 1024, and a web server may have it
                opened.append(await asyncio.start_server(server.serve_robot_api, host, robot_api.PORT))
        except OSError as error:
            for listener in opened:
                listener.close()
            if error.errno == errno.EADDRINUSE or (not wanted and error.errno in (errno.EADDRNOTAVAIL, None)):
                continue
            raise
        side = await asyncio.start_server(partial(side_channel.serve, server), "127.0.0.1", 0)
        return host, side.sockets[0].getsockname()[1]
    raise OSError(f"ports {ports} are not free {'there: another controller runs' if wanted else 'on any loopback address'}")


async def _run(options: dict[str, Any]) -> None:
    seed = int(options["seed"])
    model = load_arm(options["model"])
    length_m, angle_rad, links = options["length_error_m"], options["angle_error_rad"], model.links
    if length_m or angle_rad:
        links = links.calibrated(np.random.default_rng([int(options["links_seed"]), 1]), length_m, angle_rad)
    deviations = options["repeatability_m"], options["repeatability_rad"]
    arm = SimulatedArm(seed, np.array(options["home"]), *deviations, links, options["noise_rad"], model)
    server = ControllerServer(arm, options["time_scale"], Installation(up=tuple(options["up"])))
    host, side_port = await _listen(server, options["host"])
    loop = asyncio.get_running_loop()
    orphaned = asyncio.Event()
    loop.add_reader(sys.stdin.fileno(), lambda: None if os.read(sys.stdin.fileno(), 1024) else orphaned.set())
    sys.stdout.write(json.dumps({"host": host, "side_port": side_port}) + "\n")
    sys.stdout.flush()
    due = loop.time()
    while not orphaned.is_set():
        server.step()
        fastest = min((s.period_s for s in server.sessions if s.streaming), default=0.02)
        due = max(due + max(fastest, 1 / CYCLE_HZ), loop.time())
        await asyncio.sleep(due - loop.time())


def main() -> None:
    """Run until standard input closes."""
    asyncio.run(_run(json.loads(sys.argv[1])))


if __name__ == "__main__":
    main()
