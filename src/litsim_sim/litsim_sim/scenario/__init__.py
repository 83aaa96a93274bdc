"""What is run: a scenario of a recording, a net and an ego; its log; the plan of a run."""
