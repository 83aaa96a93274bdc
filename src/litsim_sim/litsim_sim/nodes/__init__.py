"""The nodes: bridge, recorder, replay and live view. Each is a shell around a core of another folder."""
