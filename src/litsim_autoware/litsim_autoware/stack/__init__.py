"""The stack that drives: its topics and services, the services to call before it drives, and its time."""
