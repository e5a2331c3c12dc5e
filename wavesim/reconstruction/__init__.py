"""The object from recorded frames: object-domain descent, and the retrieval of Appendix A."""
