"""The world that the bridge steps: logged and driven agents, entries, contacts, and its image in SUMO."""
