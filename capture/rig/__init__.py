"""The rig: its description, how it is opened, and the protocols of robot and camera."""
