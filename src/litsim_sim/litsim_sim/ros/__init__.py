"""Everything that knows ROS: topic names, QoS, conversion between arrays and messages, the stage shell."""
