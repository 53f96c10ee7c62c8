"""An asset's files shown by a foreign renderer, Mitsuba."""
