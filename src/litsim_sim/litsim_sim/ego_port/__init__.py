"""The ego port: answers of any driving system to a step, checked and made into one command."""
