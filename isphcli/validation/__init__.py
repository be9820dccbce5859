"""Error against run time: ladders of resolutions, stiff scenes, the figures of the paper."""
