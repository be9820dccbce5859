"""From a case to its results."""
