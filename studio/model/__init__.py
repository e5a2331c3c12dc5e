"""Model of the workbench, independent of the page: the edited lens and its analysis."""
