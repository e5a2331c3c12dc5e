"""Operands of the optimization: goals and constraints as scaled values with derivatives."""
