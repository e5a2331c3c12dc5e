"""The paper's engine: annular slices (Eqs. 3 and 4, Appendix C)."""
