"""Take a robot and a camera along a trajectory, real or simulated, and leave a recording."""
