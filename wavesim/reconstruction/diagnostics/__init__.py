"""Tests of a result: held-out pixels, trials of possible causes, a score test, and a bootstrap."""
