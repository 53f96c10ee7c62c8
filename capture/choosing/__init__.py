"""Views of an object that are chosen by what they add: while it is recorded, or before that for a known shape."""
