"""What a training decides about its scene before its first step: one decision a file, with its rule, its evidence and its words.

docs/skipping.md has the figures: what each decision saves and costs.
"""
