"""Discrete operators of one configuration of particles (paper eqs 5-7, 11)."""
