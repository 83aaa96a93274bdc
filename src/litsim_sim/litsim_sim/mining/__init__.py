"""What happens in recorded traffic: events around every possible ego with their numbers, and choices among them."""
