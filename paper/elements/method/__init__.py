"""What the paper says of the way back: Eqs. 3 to 6, the appendices, Figs. 3, 4, 9 and 11."""
