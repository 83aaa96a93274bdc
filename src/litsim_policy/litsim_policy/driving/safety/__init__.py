"""The safety layer between a network and the vehicle: limits of comfort, safe following, evasion of contacts."""
