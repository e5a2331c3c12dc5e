"""DXF files: the outline of the glass in section, and the container of drawings."""
