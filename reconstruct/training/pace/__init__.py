"""How far a training goes and how far it is: its clock, its steps, what follows the share that is done, and when it gives way."""
