"""Where fluid and walls are."""
