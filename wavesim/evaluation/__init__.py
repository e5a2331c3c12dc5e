"""How good a result is: metrics, resolved lines, engines against each other."""
