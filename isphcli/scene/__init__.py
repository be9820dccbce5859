"""From the keys of a case to the objects of a scene: the only room that imports both."""
