"""Masks of an object from posed photographs: a hull that grows out of the views' agreement, corrected by strokes.

`space` has the cells that may be the object's, `cut` divides one picture, `grow` alternates between the two, `strokes` are a
person's corrections, and `page` is where they are drawn.
"""
