"""The simulated rig: controller, arm, lens, light and laboratory, and the truth about them."""
