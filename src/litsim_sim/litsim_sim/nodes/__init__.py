"""The nodes bridge, recorder, replay and live view; each wraps a core of another folder."""
