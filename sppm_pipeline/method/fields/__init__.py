"""Lazily evaluated data: scalar fields, fields composed of fields, and the stacks of layers cut from them."""
