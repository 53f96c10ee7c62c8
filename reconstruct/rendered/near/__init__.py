"""Five scenes with near lamps, shadows and interreflection, rendered by Mitsuba: nothing that distant light can have."""
