"""RTDE without the vendor's library: the wire format, a client, and the control program that it uploads."""
