"""`check_ads`: observation of a driving system at the ego port, and judgement by the port's contract."""
