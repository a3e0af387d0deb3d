"""The parts of the report, one a file: whatever class of a :class:`..section.Section` lies here is on the page."""
