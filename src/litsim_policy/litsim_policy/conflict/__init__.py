"""The conflict stage: predicted overlaps of boxes, takeovers of agents, and their hand-back."""
