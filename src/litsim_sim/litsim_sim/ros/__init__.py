"""All code that depends on ROS: topics, QoS, conversion between arrays and messages, and the base of stages."""
