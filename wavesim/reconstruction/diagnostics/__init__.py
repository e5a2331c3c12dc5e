"""What tells whether a result is right: pixels that were held out, and what else is tried."""
