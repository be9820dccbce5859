"""Readers and writers of images, one file a format."""
