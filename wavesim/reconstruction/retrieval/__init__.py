"""Steps of Appendix A, and their compiled loops."""
