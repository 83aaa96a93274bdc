"""What people look at: a run or a campaign as one HTML file, and scenes as pictures."""
