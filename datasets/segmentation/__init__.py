"""Masks of an object from posed photographs: a hull that grows out of the views' agreement, corrected by strokes.

`standing` tells an object from the plane beneath it, of which `backdrop` knows the colours. Of other objects `space` has the
cells that may be theirs, `cut` divides one picture, and `grow` alternates between the two. `strokes` are a person's corrections,
and `page` is where they are drawn.
"""
