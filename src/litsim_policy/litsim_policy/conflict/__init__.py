"""The conflict stage: whose boxes will overlap, who is taken over, and when each is handed back."""
