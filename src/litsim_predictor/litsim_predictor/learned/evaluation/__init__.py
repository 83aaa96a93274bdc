"""How good forecasts are: errors, likelihoods, conflicts found."""
