"""Injured scenes on which the checks are tested: a simulated studio, the injuries, and the table of what is named."""
