"""What an interface between two fluids adds (paper eqs 14-24)."""
