"""Files and pictures of a run, and the display of its progress."""
