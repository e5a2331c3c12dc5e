"""What the paper says of the lens: Eqs. 1 and 2, Table 1, Figs. 1a and 2."""
