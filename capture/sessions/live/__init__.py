"""What a person wants to know of the live picture: focus, clipping, colours, flicker of the lamps, exposure."""
