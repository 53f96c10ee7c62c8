"""An asset as a body in robot simulators: convex parts for contacts, mass and inertia, URDF and MJCF files."""
