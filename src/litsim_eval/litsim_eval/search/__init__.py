"""`search`: the least changes of what people did with which a stack fails, and the margins that follow."""
