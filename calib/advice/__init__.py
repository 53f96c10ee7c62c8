"""The adviser of a session that is still being recorded: what is known after each view, and which view to take next."""
