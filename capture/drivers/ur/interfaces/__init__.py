"""What a controller serves beside RTDE: dashboard, primary interface, Robot API."""
