"""Messages of Autoware: ego, other agents and lights as bytes, from numpy arrays, and publishers of them."""
