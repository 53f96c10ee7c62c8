"""URScript, as far as a controller reads it before it runs a program."""
