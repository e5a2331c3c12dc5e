"""Drawings of the glass elements after ISO 10110."""
