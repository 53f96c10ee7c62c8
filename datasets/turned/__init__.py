"""Two sessions of one object, which a person turned over in between: how it was moved, and one scene of both."""
