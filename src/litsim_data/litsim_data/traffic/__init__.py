"""Generated traffic: SUMO's traffic with calibrated drivers, smoothed to plausible motion."""
