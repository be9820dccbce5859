"""One step of the flow of one fluid (paper eqs 1-4, 8-10) and steady creeping flow."""
