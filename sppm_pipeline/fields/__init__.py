"""What is evaluated lazily: scalar fields, what is composed of them, and the stacks of layers cut from them."""
