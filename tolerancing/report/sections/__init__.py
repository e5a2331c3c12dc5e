"""Sections of the report, as blocks of text, tables and figures."""
