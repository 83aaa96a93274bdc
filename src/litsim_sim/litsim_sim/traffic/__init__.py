"""Generated traffic: SUMO's, with drivers calibrated to recordings, smoothed to plausible motion."""
