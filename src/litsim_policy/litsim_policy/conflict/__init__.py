"""The conflict stage: which boxes will overlap, which agents are taken over, and when each is handed back."""
