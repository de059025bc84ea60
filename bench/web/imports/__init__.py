"""Foreign logs taken in by the page, in a confined process."""
