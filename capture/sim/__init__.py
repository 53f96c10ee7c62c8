"""The simulated rig: controller, camera, laboratory, and the truth about them."""
