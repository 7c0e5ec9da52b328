"""A recording shown in the operator's console: the same page, read only, with a transport."""
