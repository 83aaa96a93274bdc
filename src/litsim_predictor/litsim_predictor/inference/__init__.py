"""The learned predictors in the loop: what they read of a scene, and their networks run without torch."""

SHIPPED = ("default", "paper", "cs_lstm", "bat")
"""Names of the models that come with the package."""
ON_STREETS = "streets"
"""Name of the weights that `default` has on nets of streets."""
GRAPHS = ("paper", "cs_lstm", "bat")
"""Shipped models that ONNX Runtime runs as graphs; kernels run `default`."""
