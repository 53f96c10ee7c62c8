"""Views of an object that are chosen by what they add: during a session, or beforehand for a known shape."""
