"""Surrogate safety measures of agent tables: time to collision, headway, deceleration, post-encroachment time."""
