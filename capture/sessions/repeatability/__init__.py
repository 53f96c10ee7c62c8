"""How well the arm comes back, measured by pictures: the visits, the spread of what they show, its drawing, the session."""
