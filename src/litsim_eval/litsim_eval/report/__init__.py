"""Reports: a run or a campaign as one HTML file, text on the terminal, and scenes as pictures."""
