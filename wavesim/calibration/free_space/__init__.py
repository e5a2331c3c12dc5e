"""Frames that no lens stands before: their stack, the descent, and the field that it finds."""
