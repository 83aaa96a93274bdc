"""The predictor stage over ROS: its node, and messages of forecasts."""
