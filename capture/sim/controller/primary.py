"""The primary interface of the simulated controller: its version, its state ten times a second, and errors; takes programs."""

import asyncio
import struct

from koala3d.capture.drivers.ur.interfaces import primary
from koala3d.capture.drivers.ur.interfaces.primary import package
from koala3d.capture.model.kinematics import six_from_pose
from koala3d.capture.sim.controller.server import ControllerServer, closing
from koala3d.capture.sim.controller.state import Controller

PORTS = (30001, 30002)
PERIOD_S = 0.1
PROJECT, BUILT = b"URControl", b"2022-01-01"


def version_message(version: tuple[int, ...]) -> bytes:
    """Major, minor, bugfix and build number."""
    numbers = struct.pack(">BBii", *version)
    content = struct.pack(">Qbb", 0, -2, primary.VERSION) + bytes([len(PROJECT)]) + PROJECT + numbers + BUILT
    return package(primary.MESSAGE, content)


def exception_message(text: str, line: int, column: int) -> bytes:
    """An error in a program."""
    content = struct.pack(">Qbb", 0, -2, primary.EXCEPTION) + primary.PLACE.pack(line, column) + text.encode("latin-1", "replace")
    return package(primary.MESSAGE, content)


def state_message(controller: Controller) -> bytes:
    """Tool pose and offset, the calibrated links, and the checksum of the safety settings."""
    arm, links = controller.arm, controller.arm.links if controller.installed.calibrated else controller.arm.model.links
    pose = [*controller.tcp_pose(arm.actual(controller.now)[0]), *six_from_pose(arm.flange_from_tcp)]
    numbers = [float(one) for part in (links.theta, links.a, links.d, links.alpha) for one in part]
    parts = (
        package(primary.CARTESIAN, primary.CARTESIAN_FIELDS.pack(*pose)),
        package(primary.KINEMATICS, primary.KINEMATICS_FIELDS.pack(*[0] * 6, *numbers, 0)),
        package(primary.SAFETY, bytes.fromhex(controller.installed.checksum)),
    )
    return package(primary.STATE, b"".join(parts))


async def serve(server: ControllerServer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Serve one connection until the client leaves: it hears state and errors, and may send programs as to the script port."""
    if not server.controller.installed.primary:
        writer.close()
        return
    writer.write(version_message(server.controller.installed.version))
    telling = asyncio.create_task(_tell(server, writer))

    def tell_error(text: str, line: int, column: int) -> None:
        writer.write(exception_message(text, line, column))

    server.listeners.append(tell_error)
    with closing(writer):
        try:
            await server.take_programs(reader)
        finally:
            server.listeners.remove(tell_error)
            telling.cancel()


async def _tell(server: ControllerServer, writer: asyncio.StreamWriter) -> None:
    """Send the state over and over."""
    with closing(writer):
        while not writer.is_closing():
            if not server.controller.silent:
                writer.write(state_message(server.controller))
                await writer.drain()
            await asyncio.sleep(PERIOD_S)
