"""An asset's files shown by a foreign renderer, Mitsuba, and compared with the photographs."""
