"""An asset's pictures by a foreign renderer, compared with the photographs."""
