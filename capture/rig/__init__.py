"""The rig: how it is opened, and what every driver in it must do."""
