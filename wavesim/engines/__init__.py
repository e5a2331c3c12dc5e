"""Engines that carry fields from the object through the lens and back, and the choice between them."""
