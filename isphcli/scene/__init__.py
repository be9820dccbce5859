"""From the words of a case to the objects of a scene: the only room that knows both."""
