"""What a person has set at the pendant of the simulated controller, and how well its network works."""

from dataclasses import dataclass

VERSION = (5, 11, 5, 1010327)


@dataclass
class Installation:
    """The settings; the side channel's `install` changes them."""

    serial: str = "20235500001"
    version: tuple[int, ...] = VERSION
    remote: bool = True  # remote control, not local
    payload_kg: float = 0.5
    payload_centre: tuple[float, ...] = (0.0, 0.03, 0.05)  # centre of gravity in the flange [m]
    up: tuple[float, ...] = (0.0, 0.0, 1.0)  # unit vector away from the ground, in the base
    checksum: str = "5afe0011"  # of the safety configuration, hexadecimal
    program: str = ""  # "PLAYING" or "PAUSED": a program that somebody else has started
    dashboard: bool = True  # PolyScope X has no dashboard server
    robot_api: bool = True  # PolyScope X has one from 10.11 on; its service may be closed
    operational_mode: str = "AUTOMATIC"  # or "MANUAL", as the Robot API says it
    calibrated: bool = True  # its calibration is installed; else it says that its links are the nominal ones
    deaf_primary: bool = False  # it takes programs and does not run them
    primary: bool = True  # the primary interface may be blocked in the security settings
    fieldbus: bool = False  # PROFINET or EtherNet/IP owns the input registers 0 to 23
    latency_s: float = 0.0  # a sample arrives late by up to this much
