"""Readers of images, one file per format."""
