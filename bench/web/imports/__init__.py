"""Import of foreign logs through the page, in a confined process."""
