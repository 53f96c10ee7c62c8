"""What masks say: which colour is the object, and the space that they leave to it."""
