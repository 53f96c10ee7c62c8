"""The `capture` model of rig and trajectory: what a person describes, and the geometry and kinematics that follow from it."""
