"""Asks arm, camera and computer whether a recording can begin. Nothing moves and nothing at the pendant is changed."""
