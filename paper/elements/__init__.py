"""The elements themselves: the lens, the method, the results."""
