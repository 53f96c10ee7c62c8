"""The simulated UR controller: RTDE, script and dashboard servers around a simulated arm."""
