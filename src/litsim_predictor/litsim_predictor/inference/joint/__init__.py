"""The joint predictor run by compiled kernels, and the definitions that it shares with its model of torch."""
