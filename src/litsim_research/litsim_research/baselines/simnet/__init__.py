"""SimNet, a baseline: a raster around each agent, a residual network, and its output as motion."""
