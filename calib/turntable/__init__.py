"""The axis of a turntable, found like a joint: from pictures of a board that stands on it while it turns."""
