"""STEP files of the glass, with exact conics."""
