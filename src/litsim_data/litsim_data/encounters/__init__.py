"""Encounters: moments of recorded traffic in which a vehicle had to react to another, with what it then did."""
