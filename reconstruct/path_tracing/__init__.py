"""Pictures by Mitsuba's path tracer: of an asset through the cameras of a scene; near scenes are rendered with it as well."""
