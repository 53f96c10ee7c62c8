"""Koala as a method of NerfBaselines, which trains and measures many methods by one protocol."""
