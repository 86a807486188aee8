"""Statistics of images, and the motion that lays one surface onto another."""
