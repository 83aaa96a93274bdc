"""What people look at: a run or an experiment as one HTML file, and scenes as pictures."""
